"""What the solver says of a refinement: the same simulation of the part before, without the stress stage, and after."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from genmf_mi.core.frame import Frame
from genmf_mi.sdf import distance
from genmf_mi.stress.fem import simulation as fem
from genmf_mi.stress.fem.statistics import summary
from genmf_mi.stress.report.comparison import layer_ratio, ratios

EDGE_MM = 1.2
"""Side of the lattice that the tetrahedra come from, on a part of 100 mm: what relief needs."""


def judge(
    shapes: dict[str, tuple[np.ndarray, np.ndarray]], frame: Frame, say: Callable[[str], None] = lambda text: None
) -> dict:
    """Simulate shapes and compare them.

    Args:
        shapes: some of ``before``, ``unconstrained`` (without the stress stage) and ``after``, in this order: vertices
            ``[V,3]`` in the normalised frame and faces ``[F,3]``.

    Returns:
        ``shapes``: :func:`genmf_mi.stress.fem.statistics.summary` of each. ``ratio``: each over ``before``, see
        :func:`genmf_mi.stress.report.comparison.ratios`, and ``constrained``: after over unconstrained. ``remains``: the
        share of the increase from before to unconstrained that is left after, None where there was no increase. What
        lacks a shape is left out.

    Raises:
        SolidError, SolveError: as :func:`genmf_mi.stress.fem.simulation.simulate`.
    """
    settings = fem.Settings(size_mm=frame.size_mm, edge_mm=EDGE_MM * frame.size_mm / 100.0)
    summaries, layers, before = {}, {}, None
    for name, (vertices, faces) in shapes.items():
        say(f"simulating the stress: {name}")
        phi = distance.signed_distance(vertices, faces, settings.grid)
        lost = distance.lost_fraction(vertices, faces, phi)
        simulation = fem.simulate_distance(phi, frame, settings, fem.Laps(), lost)
        summaries[name] = summary(simulation)
        if name == "before":
            before = simulation  # the others go, as each takes a gigabyte or more
        elif before is not None:
            layers[name] = layer_ratio(before, simulation)
        del simulation
    verdict: dict = {"shapes": summaries}
    if before is not None:
        verdict["ratio"] = {
            name: {**ratios(summaries["before"], summaries[name]), "surface_layer_mean": layer}
            for name, layer in layers.items()
        }
    if {"before", "unconstrained", "after"} <= set(shapes):
        verdict["ratio"]["constrained"], verdict["remains"] = effect(
            verdict["ratio"]["unconstrained"], verdict["ratio"]["after"]
        )
    return verdict


def effect(unconstrained: dict, after: dict) -> tuple[dict[str, float], dict[str, float | None]]:
    """``constrained`` and ``remains`` of :func:`judge`, from the ratios of either part over the one before."""
    names = [name for name in after if unconstrained[name] and after[name]]
    constrained = {name: after[name] / unconstrained[name] for name in names}
    remains = {
        name: (after[name] - 1) / (unconstrained[name] - 1) if unconstrained[name] > 1 else None for name in names
    }
    return constrained, remains

"""Verification of a refinement by finite elements: one simulation of the part before, without the stress stage, and
after, with the same settings."""

from __future__ import annotations

from typing import Any

import numpy as np

from genmf_mi.core.frame import Frame
from genmf_mi.core.progress import PrefixedProgress, Progress
from genmf_mi.sdf import distance
from genmf_mi.stress.fem.settings import Settings
from genmf_mi.stress.fem.simulation import Simulation, simulate_distance
from genmf_mi.stress.fem.statistics import summary_with_warpage
from genmf_mi.stress.report.comparison import layer_ratio, ratios

EDGE_MM = 1.2
"""Side of the lattice that the tetrahedra come from, on a part of 100 mm: fine enough for relief."""


def verify(
    shapes: dict[str, tuple[np.ndarray, np.ndarray]],
    frame: Frame,
    *,
    material: str = "pla",
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Simulate shapes and compare them.

    Args:
        shapes: some of ``before``, ``unconstrained`` (without the stress stage) and ``after``, in this order: vertices
            ``[V,3]`` in the normalised frame and faces ``[F,3]``.
        frame: the size of the part; the tetrahedra grow with it.
        material: of the part, a name in :data:`genmf_mi.stress.fem.materials.MATERIALS`.

    Returns:
        ``shapes``: :func:`genmf_mi.stress.fem.statistics.summary_with_warpage` of each. ``ratio``: each over
        ``before``, see :func:`genmf_mi.stress.report.comparison.ratios`, and ``constrained``: after over unconstrained.
        ``remains``: the share of the increase from before to unconstrained that is left after, None where there was
        none. What lacks a shape is left out.

    Raises:
        ConfigError: no such material.
        SolidError, SolveError: as :func:`genmf_mi.stress.fem.simulation.simulate`.
    """
    progress = progress or Progress()
    settings = Settings(size_mm=frame.size_mm, edge_mm=EDGE_MM * frame.size_mm / 100.0, material=material)
    summaries, layers, before = {}, {}, None
    for name, (vertices, faces) in shapes.items():
        progress.stage(f"simulating the stress: {name}")
        simulation = simulated(vertices, faces, frame, settings)
        summaries[name] = summary_with_warpage(simulation, PrefixedProgress(progress, f"{name}: "))
        if name == "before":
            before = simulation  # the others are dropped, as each takes a gigabyte or more
        elif before is not None:
            layers[name] = layer_ratio(before, simulation)
        del simulation
    result: dict[str, Any] = {"shapes": summaries}
    if before is not None:
        result["ratio"] = {
            name: {**ratios(summaries["before"], summaries[name]), "surface_layer_mean": layer}
            for name, layer in layers.items()
        }
    if {"before", "unconstrained", "after"} <= set(shapes):
        result["ratio"]["constrained"], result["remains"] = effect(
            result["ratio"]["unconstrained"], result["ratio"]["after"]
        )
    return result


def effect(
    unconstrained: dict[str, float], after: dict[str, float]
) -> tuple[dict[str, float], dict[str, float | None]]:
    """``constrained`` and ``remains`` of :func:`verify`, from the ratios of either part over the one before."""
    names = [name for name in after if unconstrained.get(name) and after[name]]
    constrained = {name: after[name] / unconstrained[name] for name in names}
    remains = {
        name: (after[name] - 1) / (unconstrained[name] - 1) if unconstrained[name] > 1 else None for name in names
    }
    return constrained, remains


def simulated(vertices: np.ndarray, faces: np.ndarray, frame: Frame, settings: Settings) -> Simulation:
    """As :func:`genmf_mi.stress.fem.simulation.simulate`, of a surface that is in the normalised frame already."""
    phi = distance.signed_distance(vertices, faces, settings.grid)
    thin_fraction = distance.thin_fraction(vertices, faces, phi)
    return simulate_distance(phi, frame, settings, thin_fraction=thin_fraction)

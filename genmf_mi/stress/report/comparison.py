"""How a refinement is judged: the same simulation of two shapes, as ratios."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from genmf_mi.core.frame import HALF_EXTENT, Frame
from genmf_mi.sdf.distance import sample
from genmf_mi.stress.fem import surface, tetrahedra
from genmf_mi.stress.fem.simulation import Simulation
from genmf_mi.stress.fem.statistics import SURFACE_BAND_MM

_ALIKE = 0.1
"""Two shapes are in the same units if their longest sides differ by no more than this share, and in the same place if
the centres of their boxes do not either."""


def ratios(a: dict, b: dict) -> dict[str, float]:
    """B over A, of two summaries (:func:`genmf_mi.stress.fem.statistics.summary`)."""
    return {
        "mean": b["von_mises_mpa"]["mean"] / a["von_mises_mpa"]["mean"],
        "p99_9": b["von_mises_mpa"]["p99_9"] / a["von_mises_mpa"]["p99_9"],
        "surface_band_mean": b["surface_band"]["mean"] / a["surface_band"]["mean"],
        "surface_band_p99_9": b["surface_band"]["p99_9"] / a["surface_band"]["p99_9"],
        "displacement_max": b["displacement_max_mm"] / a["displacement_max_mm"],
    }


def in_layer(simulation: Simulation, original: Simulation) -> np.ndarray:
    """Which cells of ``simulation`` are less than 4 mm below the surface of ``original``, or outside it, ``[T]`` bool.

    The surface band of a part with relief is counted from the bottoms of its grooves too, so it reaches deeper than
    that of the part without, into material under less stress. The layer is one and the same place in both.
    """
    centroids = simulation.mesh.points[simulation.mesh.cells].mean(axis=1)
    there = _in_frame(original.frame, simulation.frame, centroids)
    return sample(original.phi, there) * original.frame.mm_per_unit >= -SURFACE_BAND_MM


def layer_ratio(original: Simulation, refined: Simulation) -> float | None:
    """Mean von Mises of ``refined`` over that of ``original`` where :func:`in_layer`; None if nothing of it is."""
    means = []
    for one in (original, refined):
        chosen = in_layer(one, original)
        if not chosen.any():
            return None
        means.append(np.average(one.field.von_mises[chosen], weights=one.field.elements.volumes[chosen]))
    return float(means[1] / means[0])


def relative_size(a: Frame, b: Path) -> float:
    """Longest side of the shape in ``b`` over that of the shape of frame ``a`` if the units are the same, else 1."""
    points = tetrahedra.read(b).points if surface.is_volume(b) else surface.load(b)[0]
    ratio = float(np.ptp(points, axis=0).max()) * a.scale / (2 * HALF_EXTENT)
    return ratio if abs(ratio - 1) < _ALIKE else 1.0


def _in_frame(target: Frame, source: Frame, points: np.ndarray) -> np.ndarray:
    """``points`` of ``source`` in ``target``: by their place in the file, or box on box where the files disagree."""
    apart = np.abs(np.subtract(target.centre, source.centre)).max() * target.scale / (2 * HALF_EXTENT)
    if apart < _ALIKE and abs(target.scale / source.scale - 1) < _ALIKE:
        return target.normalise(source.restore(points))
    return points * (source.mm_per_unit / target.mm_per_unit)

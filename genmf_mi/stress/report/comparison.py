"""Two shapes simulated with the same settings, compared as ratios."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from genmf_mi.core.frame import HALF_EXTENT, Frame
from genmf_mi.sdf.distance import sample
from genmf_mi.stress.fem import surface, volume_mesh
from genmf_mi.stress.fem.simulation import Simulation
from genmf_mi.stress.fem.statistics import SURFACE_BAND_MM

_SAME_FRAME = 0.1
"""Two shapes are in the same units if their longest sides differ by less than this share, and in the same place if the
centres of their bounding boxes do too."""


def ratios(a: dict[str, Any], b: dict[str, Any]) -> dict[str, float]:
    """B over A, of two summaries (:func:`genmf_mi.stress.fem.statistics.summary_with_warpage`); of warpage only where
    both have it."""
    bent = [one["warpage"]["flatness_mm"] for one in (a, b) if one.get("warpage")]
    return {
        "mean": b["von_mises_mpa"]["mean"] / a["von_mises_mpa"]["mean"],
        "p99_9": b["von_mises_mpa"]["p99_9"] / a["von_mises_mpa"]["p99_9"],
        "surface_band_mean": b["surface_band"]["mean"] / a["surface_band"]["mean"],
        "surface_band_p99_9": b["surface_band"]["p99_9"] / a["surface_band"]["p99_9"],
        "displacement_max": b["displacement_max_mm"] / a["displacement_max_mm"],
        **({"warpage": bent[1] / bent[0]} if len(bent) == 2 and bent[0] else {}),
    }


def in_layer(simulation: Simulation, original: Simulation) -> np.ndarray:
    """Which cells of ``simulation`` are less than 4 mm below the surface of ``original``, or outside it, ``[T]`` bool.

    The surface band of a part with relief is counted from the bottoms of its grooves too, so it reaches deeper than
    that of the part without, into material under less stress. The layer is one and the same place in both.
    """
    centroids = simulation.mesh.points[simulation.mesh.cells].mean(axis=1)
    in_original = _in_frame(original.frame, simulation.frame, centroids)
    return sample(original.phi, in_original) * original.frame.mm_per_unit >= -SURFACE_BAND_MM


def layer_ratio(original: Simulation, refined: Simulation) -> float | None:
    """Mean von Mises of ``refined`` over that of ``original`` where :func:`in_layer`; None if no cell of either is
    there."""
    means = []
    for one in (original, refined):
        chosen = in_layer(one, original)
        if not chosen.any():
            return None
        means.append(np.average(one.field.von_mises[chosen], weights=one.field.elements.volumes[chosen]))
    return float(means[1] / means[0])


def relative_size(a: Frame, b: Path) -> float:
    """Longest side of the shape in ``b`` over that of the shape of frame ``a`` if the units are the same, else 1."""
    points = volume_mesh.read(b).points if volume_mesh.is_volume_mesh(b) else surface.load(b)[0]
    ratio = float(np.ptp(points, axis=0).max()) * a.scale / (2 * HALF_EXTENT)
    return ratio if abs(ratio - 1) < _SAME_FRAME else 1.0


def _in_frame(target: Frame, source: Frame, points: np.ndarray) -> np.ndarray:
    """``points [N,3]`` of frame ``source`` in ``target``: by their file coordinates, or with the bounding boxes
    centred on one another where the files have different units or origins."""
    apart = np.abs(np.subtract(target.centre, source.centre)).max() * target.scale / (2 * HALF_EXTENT)
    if apart < _SAME_FRAME and abs(target.scale / source.scale - 1) < _SAME_FRAME:
        return target.normalise(source.restore(points))
    return points * (source.mm_per_unit / target.mm_per_unit)

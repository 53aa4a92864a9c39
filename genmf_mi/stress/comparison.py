"""How a refinement is judged: the same simulation of two shapes, as ratios."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from genmf_mi.stress import surface, tetrahedra


def ratios(a: dict, b: dict) -> dict[str, float]:
    """B over A, of two summaries (:func:`genmf_mi.stress.statistics.summary`)."""
    return {
        "mean": b["von_mises_mpa"]["mean"] / a["von_mises_mpa"]["mean"],
        "p99_9": b["von_mises_mpa"]["p99_9"] / a["von_mises_mpa"]["p99_9"],
        "surface_band_mean": b["surface_band"]["mean"] / a["surface_band"]["mean"],
        "surface_band_p99_9": b["surface_band"]["p99_9"] / a["surface_band"]["p99_9"],
        "displacement_max": b["displacement_max_mm"] / a["displacement_max_mm"],
    }


def relative_size(a: Path, b: Path) -> float:
    """Longest side of ``b`` over that of ``a`` if they are in the same units (within a tenth), else 1."""
    ratio = _longest(b) / _longest(a)
    return ratio if 0.9 < ratio < 1.1 else 1.0


def _longest(path: Path) -> float:
    points = tetrahedra.read(path).points if surface.is_volume(path) else surface.load(path)[0]
    return float(np.ptp(points, axis=0).max())

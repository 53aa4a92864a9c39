"""What was painted on a part, as a picture and in words."""

from __future__ import annotations

from typing import Any

import numpy as np
from PIL import Image

from genmf_mi.core.colour import to_linear
from genmf_mi.report import tables
from genmf_mi.report.pictures import compose

FLAT, STRONGER, WEIGHTED = "#0072b2", "#e69f00", "#009e73"
"""Of areas without relief, with a higher cap, and of those that only count more (Okabe and Ito 2008)."""
TINT = 0.75
"""How much of a region's colour its picture has, the rest is the shading."""


def region_picture(
    grey: np.ndarray, coverage: np.ndarray, mask: np.ndarray, strength: np.ndarray, weight: np.ndarray
) -> Image.Image:
    """The part in one colour, tinted where something was painted.

    Args:
        grey, coverage: ``[H,W]``, the part before its refinement, premultiplied.
        mask, strength, weight: ``[H,W]`` of :class:`genmf_mi.pipeline.regions.RegionField`, NaN beside the part.
    """
    shade = np.repeat(grey[..., None], 3, axis=2)
    relative = grey / max(float(grey.max()), 1e-6)
    shares = {
        WEIGHTED: (weight > 1) & (strength <= 1),
        STRONGER: strength > 1,
        FLAT: 1 - np.nan_to_num(mask, nan=1.0),
    }
    for colour, share in shares.items():
        paint = to_linear(np.array([int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]))
        share = TINT * np.nan_to_num(np.asarray(share, dtype=np.float64))[..., None]
        shade = (1 - share) * shade + share * relative[..., None] * paint
    return compose(shade, coverage)


def told(metrics: dict[str, Any]) -> list[str]:
    """Sentences about the regions of a run; empty if nothing was painted."""
    regions = metrics.get("regions")
    if not regions:
        return []
    whole = regions["whole_cm2"]

    def area(name: str) -> str:
        return f"{tables.text(round(regions[name], 1))}\N{NO-BREAK SPACE}cm² ({tables.percent(regions[name] / whole)})"

    sentences: list[str] = []
    if regions["flat_cm2"]:
        sentences.append(
            f"Kept flat: {area('flat_cm2')} of the surface (blue), where it moved by "
            f"{tables.text(regions['flat_max_relief_mm'])}\N{NO-BREAK SPACE}mm at most. What the texture shows "
            "there counts neither in the loss nor in the scores."
        )
    if regions["fading_cm2"]:
        sentences.append(f"In between: {area('fading_cm2')}, with a part of the cap.")
    if regions["stronger_cm2"]:
        sentences.append(f"Stronger: {area('stronger_cm2')} (orange), with a higher cap and more weight.")
    if regions["weighted_cm2"] > regions["stronger_cm2"]:
        sentences.append(f"Counts more: {area('weighted_cm2')} (orange and green).")
    return sentences

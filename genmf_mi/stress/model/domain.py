"""The shapes that a network was trained on, as the ranges of a few numbers, and whether another shape is like them."""

from __future__ import annotations

from collections.abc import Iterable

import torch
from torch import Tensor

TOLERANCE = 0.05
"""Share of a range by which a shape may leave it at either end."""
MEANING = {
    "filled": "the share of its box that it fills",
    "flatness": "its smallest extent over its largest",
    "height": "its height over its largest extent",
    "thickness": "its mean depth",
    "thickest": "its largest depth",
    "skin": "the share of it that is within a cell of the surface",
}
"""The descriptors; files of weights hold ranges under these names."""


def descriptors(phi: Tensor) -> dict[str, float]:
    """Of the body in ``phi [1,n,n,n]``; depths in cells, the others are ratios. The body must not be empty."""
    inside = phi[0] <= 0
    indices = torch.nonzero(inside)
    extents = (indices.amax(dim=0) - indices.amin(dim=0) + 1).tolist()
    depth = -phi[0][inside] * (phi.shape[-1] - 1) / 2
    return {
        "filled": len(indices) / (extents[0] * extents[1] * extents[2]),
        "flatness": min(extents) / max(extents),
        "height": extents[1] / max(extents),
        "thickness": float(depth.mean()),
        "thickest": float(depth.max()),
        "skin": float((depth < 1).float().mean()),
    }


def ranges(shapes: Iterable[Tensor]) -> dict[str, list[float]]:
    """Lowest and highest of each descriptor."""
    rows = [descriptors(phi) for phi in shapes]
    return {name: [min(r[name] for r in rows), max(r[name] for r in rows)] for name in MEANING}


def out_of_distribution(phi: Tensor, trained: dict[str, list[float]]) -> list[str]:
    """How a shape differs from all that a network was trained on; a sentence each, none if it is like them.

    Args:
        phi: ``[1,n,n,n]``. trained: :func:`ranges` of the training, or some of them.
    """
    current = descriptors(phi)
    sentences = []
    for name, (low, high) in trained.items():
        slack = TOLERANCE * (high - low)
        if not low - slack <= current[name] <= high + slack:
            sentences.append(f"{MEANING[name]} is {current[name]:.3g}, in training it was {low:.3g} to {high:.3g}")
    return sentences

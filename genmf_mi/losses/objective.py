"""The weighted sum of GenMF: every term by name, and its weight λ."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from genmf_mi.core.config import Weights
from genmf_mi.losses import appearance, geometry, perceptual
from genmf_mi.losses.alignment import Alignment
from genmf_mi.losses.bilateral import bilateral
from genmf_mi.losses.emphasis import Emphasis
from genmf_mi.render.bridge import Buffers

MARGIN = 12
"""Pixels around the object that are kept, for the windows of the losses."""
SMALLEST = 48
"""Pixels that are kept at least: AlexNet cannot process fewer than 31."""


def terms(
    part: Buffers,
    reference: Buffers,
    weights: Weights,
    alignment: Alignment,
    grain: float = 0.0,
    emphasis: Emphasis | None = None,
) -> dict[str, Tensor]:
    """The terms of the images that have a weight, unweighted, by the names of :class:`Weights`.

    Only the part of the frame around the object is compared; what LPIPS averages over is therefore smaller than in the
    evaluation.

    Args:
        part: the render being improved; without geometry buffers only its appearance is judged.
        reference: the textured object at the same rays; its depth and normals are the teacher's.
        alignment: of the part to the reference. grain: contrast below which the reference is smoothed.
        emphasis: what of the appearance counts; all of it if None.
    """
    window = _window(reference.geometry[2])
    part, reference = part.crop(window), reference.crop(window)
    teacher_depth, teacher_normal, mask = reference.geometry
    coverage = mask if part.coverage is None else part.coverage.detach()
    aligned, target = alignment(part.grey, coverage, reference.grey, mask)
    if grain > 0:
        target = bilateral(target, mask, grain)
    if emphasis is not None:
        aligned = emphasis.crop(window)(aligned, target)
    by_name = {
        "grey_l1": lambda: appearance.grey_l1(aligned, target, mask),
        "grey_lpips": lambda: perceptual.lpips(aligned, target).mean(),
        "ssim": lambda: appearance.ssim_loss(aligned, target, mask),
        "gradient_ssim": lambda: appearance.gradient_ssim_loss(aligned, target, mask),
        "gradient": lambda: appearance.gradient_match(aligned, target, mask),
        "gradient_sign": lambda: appearance.gradient_sign_penalty(aligned, target, mask),
    }
    if part.depth is not None:
        depth, normal, _ = part.geometry
        by_name |= {
            "depth_smoothness": lambda: geometry.depth_smoothness(depth, mask),
            "normal_smoothness": lambda: geometry.normal_smoothness(normal, mask),
            "teacher_depth": lambda: geometry.teacher_depth(depth, teacher_depth, mask),
            "teacher_normal": lambda: geometry.teacher_normal(normal, teacher_normal, mask),
            "normal_flip": lambda: geometry.normal_flip_penalty(normal, teacher_normal, mask),
        }
    return {name: term() for name, term in by_name.items() if getattr(weights, name) > 0}


def with_weight(terms: Mapping[str, Tensor], weights: Weights) -> dict[str, Tensor]:
    """Those of ``terms`` whose weight is not 0."""
    return {name: term for name, term in terms.items() if getattr(weights, name) > 0}


def weighted_sum(terms: Mapping[str, Tensor], weights: Mapping[str, float]) -> Tensor:
    """Σ λ L over ``terms``, each with the weight of its name."""
    return torch.stack([weights[name] * term for name, term in terms.items()]).sum()


def _window(mask: Tensor) -> tuple[slice, slice]:
    """Rows and columns of ``mask [B,1,H,W]`` that hold the object and a margin."""
    occupied = mask.amax(dim=(0, 1)) > 0

    def span(flags: Tensor) -> slice:
        inside = flags.nonzero()
        first, last = (int(inside[0]), int(inside[-1])) if len(inside) else (0, len(flags) - 1)
        margin = max(MARGIN, (SMALLEST - (last + 1 - first)) // 2)
        return slice(max(first - margin, 0), last + 1 + margin)

    return span(occupied.any(dim=1)), span(occupied.any(dim=0))

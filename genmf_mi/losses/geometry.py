"""Regularisation of the surface by its depth and normal images (GenMF, section on geometry regularisation).

Depth ``[B,1,H,W]`` in normalised units, normals ``[B,3,H,W]`` in the world frame, both averaged over a pixel's
samples with 0 outside of the object; masks ``[B,1,H,W]``. Only pixels that the object fills count.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from genmf_mi.losses.appearance import interior, masked_mean
from genmf_mi.losses.shapes import GreyImages, NormalImages, Scalar

BLUR_RADIUS = 2
"""Pixels; what the blur keeps counts as shape, the rest as noise."""


def blur(x: Float[Tensor, "B C H W"], radius: int = BLUR_RADIUS) -> Float[Tensor, "B C H W"]:
    """Separable binomial blur of ``[B,C,H,W]`` over 2·radius + 1 pixels, replicating the border."""
    kernel = torch.ones(1, dtype=torch.float64)
    for _ in range(2 * radius):
        kernel = torch.conv_transpose1d(
            kernel.view(1, 1, -1), torch.full((1, 1, 2), 0.5, dtype=torch.float64)
        ).flatten()
    kernel = kernel.to(x)
    channels = x.shape[1]
    x = F.pad(x, (radius,) * 4, mode="replicate")
    x = F.conv2d(x, kernel.view(1, 1, 1, -1).expand(channels, -1, -1, -1), groups=channels)
    return F.conv2d(x, kernel.view(1, 1, -1, 1).expand(channels, -1, -1, -1), groups=channels)


def _second_derivatives(x: Float[Tensor, "B C H W"]) -> tuple[Float[Tensor, "B C H W"], Float[Tensor, "B C H W"]]:
    """Central ∂²/∂x² and ∂²/∂y² per pixel, zero at the border; two ``[B,C,H,W]``."""
    horizontal = x[..., :, 2:] - 2 * x[..., :, 1:-1] + x[..., :, :-2]
    vertical = x[..., 2:, :] - 2 * x[..., 1:-1, :] + x[..., :-2, :]
    return F.pad(horizontal, (1, 1, 0, 0)), F.pad(vertical, (0, 0, 1, 1))


def depth_smoothness(depth: GreyImages, mask: GreyImages) -> Scalar:
    """L_depth-sm = E‖∇²(D − blur(D))‖₁, in normalised units."""
    xx, yy = _second_derivatives(depth - blur(depth))
    return masked_mean(xx.abs() + yy.abs(), interior(mask, BLUR_RADIUS + 1))


def normal_smoothness(normal: NormalImages, mask: GreyImages) -> Scalar:
    """L_norm-sm = E‖∇²(N − blur(N))‖₂, the norm over both derivatives and the three components."""
    xx, yy = _second_derivatives(normal - blur(normal))
    squared = (xx.square() + yy.square()).sum(dim=1, keepdim=True)
    return masked_mean((squared + 1e-12).sqrt() - 1e-6, interior(mask, BLUR_RADIUS + 1))


def teacher_depth(depth: GreyImages, teacher: GreyImages, mask: GreyImages) -> Scalar:
    """L_teac-depth = E|D − D_t|, in normalised units; the teacher is the initial shape."""
    return masked_mean((depth - teacher).abs(), interior(mask))


def teacher_normal(normal: NormalImages, teacher: NormalImages, mask: GreyImages) -> Scalar:
    """L_teac-norm = 1 − E|N·N_t|."""
    return 1 - masked_mean(_cosine(normal, teacher).abs(), interior(mask))


def normal_flip_penalty(normal: NormalImages, teacher: NormalImages, mask: GreyImages) -> Scalar:
    """Guard beside L_teac-norm, whose absolute value is blind to a flipped normal: E[max(0, −N·N_t)]."""
    return masked_mean((-_cosine(normal, teacher)).clamp_min(0), interior(mask))


def _cosine(a: NormalImages, b: NormalImages) -> GreyImages:
    """``[B,1,H,W]`` cosine between two normal images; a pixel's average normal is shorter than one."""
    dot = (a * b).sum(dim=1, keepdim=True)
    return dot * ((a.square().sum(dim=1, keepdim=True) + 1e-12) * (b.square().sum(dim=1, keepdim=True) + 1e-12)).rsqrt()

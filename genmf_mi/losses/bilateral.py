"""Edge-preserving smoothing (Tomasi and Manduchi, *Bilateral filtering for gray and color images*, 1998)."""

from __future__ import annotations

import torch
import torch.nn.functional as F

from genmf_mi.losses.shapes import GreyImages

SIGMA = 1.2
"""Pixels; the window is twice as far on each side."""


@torch.no_grad()
def bilateral(image: GreyImages, mask: GreyImages, contrast: float) -> GreyImages:
    """``image [B,1,H,W]`` with what differs by much less than ``contrast`` from its surroundings smoothed out.

    image: 0 outside of ``mask``, in which the averages are taken.
    """
    reach = round(2 * SIGMA)
    own = image / mask.clamp_min(1e-3)
    height, width = image.shape[2:]
    padded, inside = (F.pad(x, (reach,) * 4) for x in (own, mask))
    total, weights = torch.zeros_like(image), torch.zeros_like(image)
    for dy in range(2 * reach + 1):
        for dx in range(2 * reach + 1):
            other = padded[:, :, dy : dy + height, dx : dx + width]
            distance = ((dy - reach) ** 2 + (dx - reach) ** 2) / SIGMA**2
            weight = inside[:, :, dy : dy + height, dx : dx + width] * torch.exp(
                -0.5 * (distance + ((other - own) / contrast).square())
            )
            total += weight * other
            weights += weight
    return total / weights.clamp_min(1e-6) * mask

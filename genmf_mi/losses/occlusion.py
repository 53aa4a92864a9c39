"""Shadows that relief casts on itself, from the depth and the normals of an image.

``twolight`` knows no shadows: a groove is as bright as its walls are steep. In a room its bottom gets less light, and a
ledge shades what is under it. Both are found in the image, by marching over its depth as screen-space methods do
(Bavoil and Sainz 2008 for the sky; ray marching for lamps), which is differentiable, and exact enough for relief, which
hides nothing of itself from the camera. What lies farther than the reach casts none: it is the same before and after.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from genmf_mi.losses.shapes import GreyImages, NormalImages

DIRECTIONS, SKY_STEPS, LAMP_STEPS = 6, 2, 5
"""Directions in the image and steps along each for the sky, and steps towards a lamp."""
PENUMBRA = float(np.tan(np.radians(12.0)))
"""Half of the width of a lamp, seen from the part, as a slope."""


@dataclass(frozen=True)
class Lamps:
    """Lights in the frame of the image: x to the right, y up, z towards the viewer.

    directions: unit vectors towards the lamps ``[L,3]``. weights: ``[L]``, their sum is 1 with ``sky``, which comes
        from everywhere.
    """

    directions: Float[Tensor, "L 3"]
    weights: tuple[float, ...]
    sky: float


def visibility(
    depth: GreyImages, normal: NormalImages, mask: GreyImages, lamps: Lamps, pixel: float, reach: float
) -> GreyImages:
    """By how much less light arrives than without occlusion, 0 to 1; 1 outside of the mask.

    Args:
        depth: along the optical axis, weighted by the mask. normal: in the frame of the image, likewise.
        pixel: size of a pixel on the object. reach: of what casts shadows; both in the unit of depth.
    """
    surface = torch.where(mask > 0.5, depth / mask.clamp_min(1e-3), 1e3)
    n = F.normalize(normal, dim=1, eps=1e-6)
    lit: Tensor = lamps.sky * torch.ones_like(surface)
    seen: Tensor = lamps.sky * sky(surface, n, pixel, reach)
    for i, weight in enumerate(lamps.weights):
        direction: Tensor = lamps.directions[i]
        cosine = (n * direction[None, :, None, None]).sum(dim=1, keepdim=True).clamp_min(0)
        lit = lit + weight * cosine
        seen = seen + weight * cosine * lamp(surface, direction, pixel, reach)
    return torch.where(mask > 0.5, seen / lit, 1.0)


def lamp(surface: GreyImages, direction: Float[Tensor, " 3"], pixel: float, reach: float) -> GreyImages:
    """Share of a soft lamp that is seen from each pixel of the depth image ``surface``."""
    x, y, z = (float(k) for k in direction)
    sideways = max(float(np.hypot(x, y)), 1e-3)
    hidden: list[Tensor] = []
    for pixels in _steps(reach / pixel, LAMP_STEPS):
        way = pixels * pixel / sideways
        # How far what is there rises above the ray to the lamp
        rise = surface - way * z - _shifted(surface, pixels * x / sideways, -pixels * y / sideways)
        hidden.append(torch.sigmoid(rise / (0.5 * PENUMBRA * way)) * (rise < 2 * reach))
    return 1 - torch.stack(hidden).amax(dim=0)


def sky(surface: GreyImages, normal: NormalImages, pixel: float, reach: float) -> GreyImages:
    """Share of an even sky above the tangent plane that is seen from each pixel, weighted by its cosine."""
    slope = -normal[:, :2] / normal[:, 2:].clamp_min(0.15)  # of the height towards the viewer, to the right and up
    hidden = torch.zeros_like(surface)
    for angle in np.arange(DIRECTIONS) * 2 * np.pi / DIRECTIONS:
        x, y = float(np.cos(angle)), float(np.sin(angle))
        plane = x * slope[:, :1] + y * slope[:, 1:]
        horizon = torch.zeros_like(surface)
        for pixels in _steps(reach / pixel, SKY_STEPS):
            way = pixels * pixel
            rise = (surface - _shifted(surface, pixels * x, -pixels * y)) / way - plane
            horizon = torch.maximum(horizon, torch.where(rise * way < 2 * reach, rise, 0.0))
        hidden = hidden + horizon.square() / (1 + horizon.square())
    return 1 - hidden / DIRECTIONS


def _steps(pixels: float, count: int) -> list[float]:
    """Distances in pixels, from one to as far as ``pixels``."""
    return [float(d) for d in np.geomspace(1.0, max(pixels, 1.5), count)]


def _shifted(image: GreyImages, right: float, down: float) -> GreyImages:
    """The image that has at each pixel what is ``right`` and ``down`` of it, between pixels in proportion."""
    column, row = int(np.floor(right)), int(np.floor(down))
    x, y = right - column, down - row
    reach = max(abs(column), abs(row)) + 2
    padded = F.pad(image, (reach, reach, reach, reach), mode="replicate")
    height, width = image.shape[2:]

    def at(i: int, j: int) -> Tensor:
        top, left = reach + row + i, reach + column + j
        return padded[:, :, top : top + height, left : left + width]

    return (1 - y) * ((1 - x) * at(0, 0) + x * at(0, 1)) + y * ((1 - x) * at(1, 0) + x * at(1, 1))

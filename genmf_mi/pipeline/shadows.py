"""Renders of an iteration with the shadows that relief casts on itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from genmf_mi.losses.occlusion import Lamps, visibility
from genmf_mi.render.bridge import Buffers
from genmf_mi.render.lamps import SKY
from genmf_mi.render.scene import Scene
from genmf_mi.render.view import View, image_axes, light_rotation

REACH_MM = 2.5
"""Of what casts shadows: relief, and the ledges next to it."""


def shadowed(buffers: Buffers, scene: Scene, view: View, mm_per_unit: float) -> Buffers:
    """The picture of one view, darker where less light from lamps and sky arrives.

    The lamps are those of :mod:`genmf_mi.render.lamps`.
    """
    depth, normal, mask = buffers.geometry
    turn = light_rotation(view)
    towards = np.stack([turn @ direction / np.linalg.norm(direction) for direction in scene.lights.values()])
    weights = tuple((1 - SKY) * weight for weight in scene.light_weights.values())
    lamps = Lamps(torch.as_tensor(towards).to(normal), weights, SKY)
    local = torch.einsum("ji,bjhw->bihw", torch.as_tensor(image_axes(view)).to(normal), normal)
    pixel = 2 * scene.half_width * scene.distance / (scene.resolution * view.zoom)
    share = visibility(depth, local, mask, lamps, pixel, REACH_MM / mm_per_unit)
    return replace(buffers, grey=buffers.grey * share)

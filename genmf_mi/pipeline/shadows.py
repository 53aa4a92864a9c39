"""Renders of an iteration with the shadows that relief casts on itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from genmf_mi.losses.occlusion import Lamps, visibility
from genmf_mi.render.bridge import Buffers
from genmf_mi.render.lamps import SKY
from genmf_mi.render.scene import Scene, View, camera_to_world, rotation

REACH_MM = 2.5
"""Of what casts shadows: relief, and the ledges next to it."""


def shadowed(buffers: Buffers, scene: Scene, view: View, mm_per_unit: float) -> Buffers:
    """The picture of one view, darker where less light from lamps and sky arrives.

    The lamps are those of :mod:`genmf_mi.render.lamps`.
    """
    depth, normal, mask = buffers.geometry
    turn = rotation("y", view.light_turn[0]) @ rotation("x", view.light_turn[1])
    towards = np.stack([turn @ direction / np.linalg.norm(direction) for direction in scene.lights.values()])
    material = scene.material
    weights = [material["key_weight" if key.endswith("key") else "fill_weight"] for key in scene.lights]
    lamps = Lamps(torch.as_tensor(towards).to(normal), tuple((1 - SKY) * weight for weight in weights), SKY)
    # Mitsuba's camera has x to the left and looks along z
    axes = torch.as_tensor(camera_to_world(view, scene.distance)[:3, :3] * [-1, 1, -1]).to(normal)
    local = torch.einsum("ji,bjhw->bihw", axes, normal)
    pixel = 2 * scene.half_width * scene.distance / (scene.resolution * view.zoom)
    share = visibility(depth, local, mask, lamps, pixel, REACH_MM / mm_per_unit)
    return replace(buffers, grey=buffers.grey * share)

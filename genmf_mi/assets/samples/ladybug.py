"""A ladybird: seven spots and a split on red wing cases, white patches beside the head, and a face; flat underneath."""

from __future__ import annotations

import numpy as np

from genmf_mi.assets.samples.charts import Chart, cube_sphere
from genmf_mi.assets.samples.pattern import cut, ellipsoid, inside, mix, noise, ramp, rgb, union

_FOOT = -0.16
_WINGS = (0, -0.10, -0.07), (0.40, 0.40, 0.45)
_COLLAR = (0, -0.05, 0.26), (0.285, 0.225, 0.17)
_HEAD = (0, -0.04, 0.385), (0.20, 0.17, 0.135)
# x and z of a spot's middle seen from above, and its radius.
_SPOTS = [(0, 0.06, 0.072), (0.20, 0.02, 0.07), (0.235, -0.19, 0.078), (0.115, -0.35, 0.066)]


def charts() -> list[Chart]:
    return cube_sphere(_field, stretch=(1, 0.75, 1.1))


def paint(points: np.ndarray, texel: float) -> np.ndarray:
    mirrored = np.column_stack([np.abs(points[:, 0]), points[:, 1:]])
    wings, collar, head = (ellipsoid(points, *body) for body in (_WINGS, _COLLAR, _HEAD))

    grain = noise(points, 7, 110, octaves=3)
    red = mix(rgb("d92a1c"), rgb("c01a14"), ramp(grain, -1.5, 1.5))
    red = mix(red, rgb("a81210"), ramp(points[:, 1], 0.0, -0.15))
    dark = mix(rgb("1d191b"), rgb("2a2427"), ramp(grain, -1.5, 1.5))
    for x, z, radius in _SPOTS:
        middle = _on_wings(x, z)
        # Rounder than a cut with a ball: the outline wobbles a little.
        spot = np.linalg.norm(mirrored - middle, axis=1) - radius * (1 + 0.025 * grain)
        red = mix(red, rgb("8c0f0e"), 0.6 * ramp(spot, 0.014, 0.002))
        red = mix(red, dark, inside(spot, texel))
    split = mirrored[:, 0] - 0.0075 - 0.012 * ramp(points[:, 2], -0.38, -0.53)
    red = mix(red, dark, inside(split, texel))

    patch = ellipsoid(mirrored, (0.20, 0.06, 0.29), (0.075, 0.115, 0.085))
    cream = mix(rgb("f6efdc"), rgb("e8dcc0"), ramp(grain, -1.5, 1.5))
    black = mix(dark, cream, inside(patch, texel) * inside(collar - head, texel))
    face = np.where(points[:, 2] > 0.40, 0, 1)
    eye = np.linalg.norm(mirrored - [0.085, 0.035, 0.49], axis=1)
    black = mix(black, rgb("faf6ea"), inside(eye - 0.058, texel))
    black = mix(black, dark, inside(np.linalg.norm(mirrored - [0.078, 0.030, 0.515], axis=1) - 0.039, texel))
    for x in (0.090, -0.068):
        glint = np.hypot(points[:, 0] - x, points[:, 1] - 0.044) - 0.0125 + face
        black = mix(black, rgb("faf6ea"), inside(glint, texel))
    smile = np.abs(np.hypot(points[:, 0], points[:, 1] + 0.005) - 0.075) - 0.008
    smile = np.maximum(smile, points[:, 1] + 0.035) + face
    black = mix(black, rgb("e9a090"), inside(smile, texel))

    colour = mix(red, black, inside(np.minimum(collar, head) - wings, texel))
    return mix(colour, dark, inside(points[:, 1] - _FOOT - 0.02, texel))


def _on_wings(x: float, z: float) -> np.ndarray:
    """The point of the wing cases above ``(x, z)``."""
    centre, axes = np.array(_WINGS)
    rest = 1 - ((x - centre[0]) / axes[0]) ** 2 - ((z - centre[2]) / axes[2]) ** 2
    return np.array([x, centre[1] + axes[1] * np.sqrt(rest), z])


def _field(points: np.ndarray) -> np.ndarray:
    wings, collar, head = (ellipsoid(points, *body) for body in (_WINGS, _COLLAR, _HEAD))
    body = union(union(wings, collar, 0.05), head, 0.04)
    return cut(body, _FOOT - points[:, 1], 0.03)

"""A strawberry: pale seeds with dark rims in spiral rows, a green calyx with veins."""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial import KDTree

from genmf_mi.assets.samples.charts import Chart, cast, cube_sphere
from genmf_mi.assets.samples.pattern import cut, inside, mix, noise, ramp, rgb, union

# Radius and height of the outline from the dimple under the calyx to the tip.
_OUTLINE = np.array(
    [(0, 0.335), (0.10, 0.362), (0.22, 0.375), (0.33, 0.335), (0.405, 0.245), (0.435, 0.12), (0.42, -0.02),
     (0.365, -0.17), (0.285, -0.31), (0.20, -0.42), (0.115, -0.495), (0.05, -0.525), (0, -0.532)]
)  # fmt: skip
_FOOT = -0.478  # the flattened tip it stands on
_SPACING = 0.082  # between seeds
_SEPALS = 9


def charts() -> list[Chart]:
    return cube_sphere(_field, stretch=(0.95, 1, 0.95))


def paint(points: np.ndarray, texel: float) -> np.ndarray:
    colour = mix(rgb("b3141f"), rgb("8f0c1a"), ramp(noise(points, 4, 10, octaves=3), -1.5, 2))
    colour = mix(colour, rgb("d8574a"), 0.8 * ramp(points[:, 1], 0.26, 0.40))

    seeds, down = _seeds()
    _, nearest = KDTree(seeds).query(points)
    offset = points - seeds[nearest]
    along = np.einsum("ij,ij->i", offset, down[nearest])
    across = np.sqrt(np.maximum(np.einsum("ij,ij->i", offset, offset) - along**2, 0))
    # A drop, broad towards the tip of the berry.
    drop = np.hypot(across * (1.75 - 16 * along), along) - 0.0235
    colour = mix(colour, rgb("5a0612"), 0.75 * ramp(drop, 0.026, 0.006))
    colour = mix(colour, rgb("3c040c"), inside(drop - 0.0075, texel))
    seed = mix(rgb("f7dc8b"), rgb("fdf0bd"), ramp(along, -0.02, 0.015))
    colour = mix(colour, seed, inside(drop, texel))

    leaf, vein = _calyx(points)
    colour = mix(colour, rgb("4a0810"), 0.7 * ramp(leaf, 0.022, 0.004))
    on_leaf = leaf < texel
    colour[on_leaf] = mix(
        colour[on_leaf],
        _paint_calyx(points[on_leaf], leaf[on_leaf], vein[on_leaf], texel),
        inside(leaf[on_leaf], texel),
    )
    return colour


def _paint_calyx(points: np.ndarray, leaf: np.ndarray, vein: np.ndarray, texel: float) -> np.ndarray:
    green = mix(rgb("3f7a2a"), rgb("5d9a38"), ramp(noise(points, 9, 20, octaves=2), -1.5, 1.5))
    green = mix(green, rgb("bcd97e"), inside(vein, texel))
    green = mix(green, rgb("24501b"), ramp(leaf, -0.016, -0.002))
    bark = mix(rgb("9bbf62"), rgb("a88f58"), ramp(points[:, 1], 0.42, 0.46))
    return mix(green, bark, ramp(_stalk(points), 0.03, 0.012))


def _field(points: np.ndarray) -> np.ndarray:
    radius = np.linalg.norm(points, axis=-1)
    polar = np.arctan2(np.hypot(points[:, 0], points[:, 2]), points[:, 1])
    azimuth = np.arctan2(points[:, 2], points[:, 0])
    lobes = 1 + np.sin(polar) ** 2 * (0.022 * np.cos(2 * azimuth + 0.5) + 0.014 * np.cos(3 * azimuth + 1.0))
    berry = radius - _radius()(polar) * lobes
    berry = cut(berry, _FOOT - points[:, 1], 0.025)
    # The leaves follow the berry, thicker along the middle.
    leaf, _ = _calyx(points)
    berry = berry - 0.024 * ramp(leaf, 0.012, -0.03)
    return union(berry, cut(_stalk(points), np.abs(points[:, 1] - 0.3) - 0.165, 0.03), 0.06)


def _stalk(points: np.ndarray) -> np.ndarray:
    """Distance to an endless stalk, bent and thinner upwards."""
    above = np.maximum(points[:, 1] - 0.34, 0)
    return np.hypot(points[:, 0] - 0.35 * above, points[:, 2]) - 0.042 + 0.08 * above


def _calyx(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distances along the berry ``[N]`` to the union of the leaves and to their midribs; infinite far below them."""
    polar = np.arctan2(np.hypot(points[:, 0], points[:, 2]), points[:, 1])
    leaf, vein = np.full((2, len(points)), np.inf)
    near = polar < 1.2
    length = 0.40 * polar[near]
    azimuth = np.arctan2(points[near, 2], points[near, 0]) + 0.16 * np.sin(5 * polar[near])
    for i in range(_SEPALS):
        swing, long = 0.09 * np.sin(2.4 * i), 0.37 + 0.05 * np.sin(1.7 * i + 0.5)
        turn = np.angle(np.exp(1j * (azimuth - 2 * np.pi * i / _SEPALS - swing)))
        across = np.where(np.abs(turn) < np.pi / 2, np.abs(length * np.sin(turn)), np.inf)
        t = np.clip(length / long, 0, 1)
        width = 0.128 * np.sqrt(t) * (1 - t) ** 0.75
        distance = np.where(t < 1, across - width, np.hypot(across, length - long))
        leaf[near] = np.minimum(leaf[near], distance)
        vein[near] = np.minimum(vein[near], across - 0.007 * np.sqrt(np.clip(0.95 - t, 0, 1)))
    leaf[near] = np.minimum(leaf[near], length - 0.09)
    return leaf, vein


@cache
def _radius() -> CubicSpline:
    """Distance of the outline from the origin over the polar angle."""
    return CubicSpline(np.arctan2(_OUTLINE[:, 0], _OUTLINE[:, 1]), np.hypot(*_OUTLINE.T), bc_type="clamped")


@cache
def _seeds() -> tuple[np.ndarray, np.ndarray]:
    """Points ``[S,3]`` and directions down the berry ``[S,3]``: equal areas a golden angle apart, as they grow."""
    polar = np.linspace(0, np.pi, 2000)
    outline = _radius()(polar)[:, None] * np.stack([np.sin(polar), np.cos(polar)], axis=1)
    middle = (outline[1:] + outline[:-1]) / 2
    area = np.concatenate([[0], np.cumsum(2 * np.pi * middle[:, 0] * np.linalg.norm(np.diff(outline, axis=0), axis=1))])
    count = int(area[-1] / (_SPACING**2 * np.sqrt(3) / 2))
    at = np.interp((np.arange(count) + 0.5) / count * area[-1], area, polar)
    azimuth = np.arange(count) * np.pi * (3 - np.sqrt(5))

    def on_berry(angle: np.ndarray) -> np.ndarray:
        rays = np.stack([np.sin(angle) * np.cos(azimuth), np.cos(angle), np.sin(angle) * np.sin(azimuth)], axis=1)
        return cast(_field, rays)

    seeds, ahead = on_berry(at), on_berry(at + 0.02)
    down = (ahead - seeds) / np.linalg.norm(ahead - seeds, axis=1, keepdims=True)
    leaf, _ = _calyx(seeds)
    keep = (leaf > 0.03) & (seeds[:, 1] > _FOOT + 0.03)
    return seeds[keep], down[keep]

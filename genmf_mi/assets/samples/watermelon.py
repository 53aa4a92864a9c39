"""A watermelon: wavy dark stripes from the stem to the blossom end, a pale patch where it lay in the field."""

from __future__ import annotations

import numpy as np

from genmf_mi.assets.samples.charts import Chart, cube_sphere
from genmf_mi.assets.samples.pattern import cut, ellipsoid, inside, mix, noise, ramp, rgb, union

_STRIPES = 11
_AXES = np.array([0.5, 0.4, 0.4])
_FOOT = -0.36


def charts() -> list[Chart]:
    return cube_sphere(_field, stretch=(1.15, 1, 1))


def paint(points: np.ndarray, texel: float) -> np.ndarray:
    mottle = noise(points, 13, 31, octaves=3)
    colour = mix(rgb("a3c466"), rgb("c9dd92"), ramp(mottle, -1.5, 1.5))
    # Fine netting: the lines where a noise is zero.
    net = np.abs(noise(points, 15, 40, octaves=2))
    colour = mix(colour, rgb("7fa650"), 0.45 * ramp(net, 0.12, 0.03))

    stripe = _stripe(points)
    shade = mix(rgb("1d4a22"), rgb("12351a"), ramp(mottle, -1.2, 1.5))
    colour = mix(colour, rgb("6d9a48"), 0.6 * ramp(stripe, 0.018, 0.002))
    colour = mix(colour, shade, inside(stripe, 1.5 * texel))

    spot = np.linalg.norm((points - [0.10, -0.30, 0.26]) / [1.5, 1, 1], axis=1) + 0.012 * noise(
        points, 9, 50, octaves=3
    )
    straw = mix(rgb("efe0a0"), rgb("dcc988"), ramp(mottle, -1, 2))
    colour = mix(colour, straw, 0.95 * ramp(spot, 0.185, 0.125))

    around = np.hypot(points[:, 1], points[:, 2])
    blossom = np.where(points[:, 0] < 0, around, 1)
    colour = mix(colour, rgb("b99a5c"), ramp(blossom, 0.045, 0.03))
    colour = mix(colour, rgb("4a3a20"), inside(np.abs(blossom - 0.020) - 0.006, texel))
    stem = _stem(points)
    colour = mix(colour, rgb("5b7a3a"), ramp(stem, 0.034, 0.012))
    bark = mix(rgb("8a8a4c"), rgb("b9a36a"), ramp(points[:, 0], 0.50, 0.54))
    return mix(colour, bark, ramp(stem, 0.012, 0.004))


def _stripe(points: np.ndarray) -> np.ndarray:
    """Distance to the dark stripes along the surface."""
    radius = np.hypot(points[:, 1], points[:, 2])
    pitch = 2 * np.pi * np.maximum(radius, 0.02) / _STRIPES
    wander = 0.16 * noise(points, 3.5, 60) + 0.05 * np.sin(23 * points[:, 0])
    place = np.arctan2(points[:, 2], points[:, 1]) * _STRIPES / (2 * np.pi) + wander
    number = np.round(place) % _STRIPES
    broad = 0.25 + 0.05 * np.sin(2.4 * number + 1)
    jagged = 0.30 * noise(points, 14, 70, octaves=3) * ramp(radius, 0.0, 0.2)
    side = np.abs(place - np.round(place)) * pitch
    return np.maximum(side - pitch * broad - 0.028 * jagged, 0.055 - radius)


def _field(points: np.ndarray) -> np.ndarray:
    melon = ellipsoid(points, (0, 0, 0), _AXES) + 0.012 * np.exp(-np.sum(points[:, 1:] ** 2, axis=1) / 0.004)
    melon = cut(melon, _FOOT - points[:, 1], 0.02)
    return union(melon, cut(_stem(points), np.abs(points[:, 0] - 0.46) - 0.085, 0.02), 0.035)


def _stem(points: np.ndarray) -> np.ndarray:
    """Distance to the line of the stem, bent upwards."""
    out = np.maximum(points[:, 0] - 0.46, 0)
    return np.where(points[:, 0] > 0, np.hypot(points[:, 1] - 0.3 * out, points[:, 2]) - 0.028 + 0.06 * out, 1)

"""A toy ball with a flat spot: letters and stars on a pale band, striped caps, a star on top; it reads along ±z."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from genmf_mi.assets.samples.charts import Chart, cube_sphere
from genmf_mi.assets.samples.pattern import cut, inside, mix, noise, ramp, rgb

_RADIUS = 0.5
_FOOT = -0.47
_BAND = np.radians(27)  # latitude of its edges
_CAP = np.radians(66)
_SECTORS = 10
_STROKE = 0.021  # half the width of a letter's stroke


def charts() -> list[Chart]:
    return cube_sphere(_field)


def paint(points: np.ndarray, texel: float) -> np.ndarray:
    latitude = np.arctan2(points[:, 1], np.hypot(points[:, 0], points[:, 2]))
    longitude = np.arctan2(points[:, 0], points[:, 2])
    # Front and back alike; the seam between them is at the stars.
    half = longitude - np.pi * np.round(longitude / np.pi)
    grain = noise(points, 6, 410, octaves=3)
    cream = mix(rgb("f8f1df"), rgb("efe4c8"), ramp(grain, -2, 2))
    navy = mix(rgb("141f52"), rgb("1b2863"), ramp(grain, -2, 2))
    crimson = mix(rgb("9c1c22"), rgb("86161c"), ramp(grain, -2, 2))
    yellow = mix(rgb("f7ca3c"), rgb("eebb2c"), ramp(grain, -2, 2))
    blue = mix(rgb("1f5aa0"), rgb("1a4f90"), ramp(grain, -2, 2))

    band = mix(cream, navy, inside(_lettering(_RADIUS * half, _RADIUS * latitude), texel))
    quarter = np.where(np.abs(points[:, 0]) > 0.3, 0, 1) + _star(
        points[:, 2] * np.sign(points[:, 0]), points[:, 1], 0.15
    )
    band = mix(band, crimson, inside(quarter, texel))

    pitch = 2 * np.pi / _SECTORS
    place = longitude / pitch
    stripe = (np.abs(place - 2 * np.round(place / 2)) - 0.5) * pitch * _RADIUS * np.cos(latitude)
    cap = mix(blue, yellow, inside(stripe, texel))
    pole = np.where(points[:, 1] > 0, _star(points[:, 0], points[:, 2], 0.155), 1)
    cap = mix(cap, mix(cream, crimson, inside(pole, texel)), inside(_RADIUS * (_CAP - np.abs(latitude)), texel))

    colour = mix(band, cap, inside(_RADIUS * (_BAND - np.abs(latitude)), texel))
    edges = np.minimum(np.abs(np.abs(latitude) - _BAND), np.abs(np.abs(latitude) - _CAP)) * _RADIUS - 0.009
    return mix(colour, navy, inside(edges, texel))


def _field(points: np.ndarray) -> np.ndarray:
    return cut(np.linalg.norm(points, axis=-1) - _RADIUS, _FOOT - points[:, 1], 0.02)


def _star(x: np.ndarray, y: np.ndarray, radius: float) -> np.ndarray:
    """Distance to the edge of a star with five points, one of them along +y; negative inside."""
    angle = np.arctan2(x, y)
    fold = np.abs(angle - 2 * np.pi / 5 * np.round(angle / (2 * np.pi / 5)))
    away = np.hypot(x, y)
    tip = np.array([radius, 0])
    notch = 0.45 * radius * np.array([np.cos(np.pi / 5), np.sin(np.pi / 5)])
    normal = np.array([notch[1] - tip[1], tip[0] - notch[0]]) / np.linalg.norm(notch - tip)
    return (away * np.cos(fold) - tip[0]) * normal[0] + away * np.sin(fold) * normal[1]


def _arc(x: float, y: float, across: float, up: float, start: float, stop: float) -> list[tuple[float, float]]:
    """Points of an elliptic arc around ``(x, y)``, angles in degrees."""
    angles = np.radians(np.linspace(start, stop, 17))
    return [(x + across * np.cos(a), y + up * np.sin(a)) for a in angles]


# Strokes of the letters in em, side by side; the baseline is at 0 and capitals are 1 high.
_LETTERS = [
    [*_arc(0.42, 0.5, 0.42, 0.5, 48, 320), (0.79, 0.44), (0.47, 0.44)],  # G
    [(1.15, 0.34), *_arc(1.42, 0.34, 0.29, 0.34, 0, 315)],  # e
    [(2.08, 0.0), (2.08, 0.66)],  # n
    [(2.08, 0.36), *_arc(2.34, 0.38, 0.26, 0.28, 180, 0), (2.60, 0.0)],
    [(2.96, 0.0), (2.96, 1.0), (3.38, 0.30), (3.80, 1.0), (3.80, 0.0)],  # M
    [(4.18, 0.0), (4.18, 1.0), (4.74, 1.0)],  # F
    [(4.18, 0.52), (4.62, 0.52)],
]
_EM = 0.185


def _lettering(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Distance to the word, centred at the origin, of points ``[N]`` of the unrolled band; 1 far from it."""
    distance = np.ones(len(x))
    near = (np.abs(y) < 0.15) & (np.abs(x) < 0.5)
    at = np.stack([x[near] / _EM + 2.37, y[near] / _EM + 0.5], axis=1)
    nearest = np.full(len(at), np.inf)
    for stroke in _LETTERS:
        corners = np.array(stroke)
        for start, stop in pairwise(corners):
            along = np.clip((at - start) @ (stop - start) / ((stop - start) @ (stop - start)), 0, 1)
            offset = at - start - along[:, None] * (stop - start)
            nearest = np.minimum(nearest, np.einsum("ij,ij->i", offset, offset))
    distance[near] = _EM * np.sqrt(nearest) - _STROKE
    return distance

"""A nesting doll: a face with lashes and parted hair under a dotted headscarf, flowers on the apron, and plain turned
wood with its grain where it is not painted."""

from __future__ import annotations

import numpy as np

from genmf_mi.assets.samples.charts import Chart, cube_sphere
from genmf_mi.assets.samples.pattern import cut, ellipsoid, inside, mix, noise, ramp, rgb, union

_BODY = (0, -0.16, 0), (0.30, 0.345, 0.30)
_HEAD = (0, 0.27, 0), (0.222, 0.225, 0.222)
_FOOT = -0.47
_NECK = 0.105  # height of the scarf's hem


def charts() -> list[Chart]:
    return cube_sphere(_field, stretch=(1, 1.45, 1))


def paint(points: np.ndarray, texel: float) -> np.ndarray:
    grain = noise(points, 6, 520, octaves=3)
    cream = mix(rgb("f7ead0"), rgb("eddcb9"), ramp(grain, -1.5, 1.5))
    ink = np.broadcast_to(rgb("231815"), points.shape)
    red = mix(rgb("a51c26"), rgb("93151f"), ramp(grain, -1.5, 1.5))

    colour = _wood(points)
    # The apron: a shield on the front, with a scalloped hem.
    across, up = _unrolled(points, 0.29), points[:, 1]
    angle = np.arctan2(across, up + 0.15)
    shield = np.hypot(across / 0.215, (up + 0.15) / 0.225) - 1 - 0.035 * np.abs(np.sin(8 * angle))
    shield = np.where(points[:, 2] > 0, 0.21 * shield, 1)
    colour = mix(colour, red, inside(shield - 0.022, texel))
    colour = mix(colour, cream, inside(shield, texel))
    colour = _bouquet(colour, across, up + 0.15, points[:, 2] > 0, texel)

    scarf = _scarf(points, red, cream, texel)
    hem = points[:, 1] - _NECK + 0.02 * np.cos(12 * np.arctan2(points[:, 0], points[:, 2]))
    colour = mix(colour, scarf, inside(-hem, texel))
    colour = mix(colour, cream, inside(np.abs(hem) - 0.009, texel))
    return _face(colour, points, ink, cream, texel)


def _wood(points: np.ndarray) -> np.ndarray:
    """Year rings around a pith beside the axis, cut by the surface, with dark late wood and fine pores."""
    wander = 0.018 * noise(points * [1, 0.35, 1], 4, 530, octaves=2)
    ring = np.hypot(points[:, 0] - 0.33, points[:, 2] - 0.10 + 0.12 * points[:, 1]) + wander
    phase = np.mod(ring / 0.034, 1)
    late = ramp(phase, 0.35, 0.92) * ramp(phase, 1.0, 0.95)
    pores = ramp(noise(points * [1, 0.08, 1], 45, 540), 1.1, 1.9)
    wood = mix(rgb("e2b676"), rgb("6f3f1a"), 0.9 * late)
    return mix(wood, rgb("6b4320"), 0.55 * pores)


def _scarf(points: np.ndarray, red: np.ndarray, cream: np.ndarray, texel: float) -> np.ndarray:
    """Red with cream dots in rows around the head, each with a red heart."""
    centre = np.array(_HEAD[0])
    offset = points - centre
    height = np.arcsin(np.clip(offset[:, 1] / np.linalg.norm(offset, axis=1), -1, 1))
    turn = np.arctan2(offset[:, 0], offset[:, 2])
    row = np.round(height / 0.36)
    count = np.maximum(np.round(16 * np.cos(0.36 * row)), 1)
    step = 2 * np.pi / count
    beside = np.abs(turn / step + 0.5 * np.mod(row, 2) - np.round(turn / step + 0.5 * np.mod(row, 2))) * step
    dot = 0.222 * np.hypot(beside * np.cos(height), height - 0.36 * row)
    colour = mix(red, cream, inside(dot - 0.0215, texel))
    return mix(colour, red, inside(dot - 0.008, texel))


def _face(colour: np.ndarray, points: np.ndarray, ink: np.ndarray, cream: np.ndarray, texel: float) -> np.ndarray:
    front = np.where(points[:, 2] > 0, 0, 1)
    x, y = _unrolled(points, 0.222), points[:, 1] - 0.265
    side = np.abs(x)
    oval = np.hypot(x / 0.150, (y + 0.005) / 0.142) * 0.145 - 0.145 + front
    skin = mix(rgb("f9e0c4"), rgb("f3d3b2"), ramp(np.hypot(x, y), 0.05, 0.14))
    skin = mix(skin, rgb("e88f83"), 0.75 * ramp(np.hypot(side - 0.083, y + 0.045), 0.038, 0.012))
    hair = 0.112 - 1.6 * side**1.55 - y  # negative above the hairline
    strands = 0.5 + 0.5 * np.sin(np.hypot(side - 0.005, y - 0.17) * 620)
    skin = mix(skin, mix(rgb("43230f"), rgb("7d4a24"), strands), inside(hair, texel))

    white = np.hypot((side - 0.058) / 1.25, y - 0.012) - 0.0205
    skin = mix(skin, rgb("fffaf0"), inside(white, texel))
    iris = np.hypot(side - 0.056, y - 0.013)
    skin = mix(skin, rgb("2b4a73"), inside(np.maximum(iris - 0.0175, white), texel))
    skin = mix(skin, ink, inside(iris - 0.0095, texel))
    skin = mix(skin, rgb("fffaf0"), inside(np.hypot(x - np.sign(x) * 0.056 + 0.006, y - 0.020) - 0.0048, texel))
    lid = np.where(y > 0.006 - 0.1 * (side - 0.058), np.abs(white) - 0.0045, 1)
    along = np.arctan2(y - 0.012, (side - 0.058) / 1.25)
    lash = np.abs(np.mod(along / 0.42, 1) - 0.5) * 0.42 * 0.026 - 0.0022
    lash = np.where((white > 0) & (white < 0.013) & (along > 0.15) & (along < 2.95), lash, 1)
    skin = mix(skin, ink, inside(np.minimum(lid, lash), texel))
    brow = np.abs(np.hypot((side - 0.058) / 1.3, y + 0.022) - 0.073) - 0.0045
    skin = mix(skin, rgb("43230f"), inside(np.where((y > 0.028) & (side > 0.02) & (side < 0.1), brow, 1), texel))

    nose = np.where(y < -0.026, np.abs(np.hypot(x, y + 0.024) - 0.013) - 0.0032, 1)
    skin = mix(skin, rgb("a05a40"), inside(nose, texel))
    lips = np.minimum(np.hypot((side - 0.012) / 1.35, y + 0.069) - 0.0125, np.hypot(x / 1.9, y + 0.075) - 0.0135)
    skin = mix(skin, rgb("b4121f"), inside(lips, texel))
    smile = np.abs(np.hypot(x, y + 0.03) - 0.0465) - 0.0022
    skin = mix(skin, rgb("6a0a12"), inside(np.where((y < -0.064) & (side < 0.031), smile, 1), texel))
    colour = mix(colour, ink, inside(oval - 0.026, texel))
    colour = mix(colour, cream, inside(oval - 0.019, texel))
    return mix(colour, skin, inside(oval, texel))


def _bouquet(colour: np.ndarray, x: np.ndarray, y: np.ndarray, front: np.ndarray, texel: float) -> np.ndarray:
    """Three flowers with stems and leaves, on the front only."""
    hidden = np.where(front, 0, 1)
    stem = np.minimum(np.abs(x) - 0.006, np.abs(np.abs(x) - 1.6 * (y + 0.14) ** 2 - 0.002) - 0.006)
    stem = np.where((y < 0.02) & (y > -0.155), stem, 1) + hidden
    colour = mix(colour, rgb("1f5a35"), inside(stem, texel))
    for place, height, turn in ((0.055, -0.105, 0.6), (0.105, -0.035, 0.35)):
        u, v = np.abs(x) - place, y - height
        along, beside = np.cos(turn) * u + np.sin(turn) * v, np.cos(turn) * v - np.sin(turn) * u
        leaf = np.hypot(along / 2.5, beside) - 0.0185 + hidden
        colour = mix(colour, rgb("1f5a35"), inside(leaf, texel))
        colour = mix(colour, rgb("b9d18c"), inside(np.maximum(np.abs(beside) - 0.003, leaf + 0.005), texel))
    for place, height, size, code in ((0, 0.055, 0.092, "b01c2a"), (0.122, 0.015, 0.058, "1c3f7c")):
        u, v = np.abs(x) - place, y - height
        petals = np.hypot(u, v) - size * (0.78 + 0.22 * np.abs(np.cos(2.5 * np.arctan2(u, v)))) + hidden
        colour = mix(colour, rgb(code), inside(petals, texel))
        veins = np.abs(np.mod(np.arctan2(u, v) / (np.pi / 5) + 0.5, 1) - 0.5) * (np.pi / 5) * np.hypot(u, v)
        veins = np.where((np.hypot(u, v) < 0.74 * size) & (np.hypot(u, v) > 0.3 * size), veins - 0.0036, 1) + hidden
        colour = mix(colour, rgb("f7ead0"), inside(veins, texel))
        colour = mix(colour, rgb("f2c230"), inside(np.hypot(u, v) - 0.28 * size + hidden, texel))
    return colour


def _unrolled(points: np.ndarray, radius: float) -> np.ndarray:
    """Distance along the front of a round body of that radius, from the middle."""
    return radius * np.arctan2(points[:, 0], points[:, 2])


def _field(points: np.ndarray) -> np.ndarray:
    return cut(union(ellipsoid(points, *_BODY), ellipsoid(points, *_HEAD), 0.07), _FOOT - points[:, 1], 0.02)

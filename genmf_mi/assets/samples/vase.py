"""A painted vase of red clay: tongues at the neck, a meander, a frieze of fish over waves, rays at the foot."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import PchipInterpolator

from genmf_mi.assets.samples.charts import Chart, cube_sphere
from genmf_mi.assets.samples.pattern import cut, inside, mix, noise, ramp, rgb

_PROFILE = PchipInterpolator(
    [-0.60, -0.50, -0.42, -0.25, -0.02, 0.16, 0.30, 0.40, 0.50, 0.60],
    [0.20, 0.205, 0.225, 0.325, 0.385, 0.345, 0.245, 0.205, 0.225, 0.24],
)
"""Height to radius."""
_FISH_SIZE = 1.55
_FISH, _KEYS, _TONGUES, _RAYS, _WAVES = 8, 22, 26, 18, 28
_KEY = (
    "111111111", "100000001", "101111101", "101000101", "101011101", "101010001", "101011111", "001000000", "111111111",
)  # fmt: skip
"""One period of the meander, from above: 1 is black."""


def charts() -> list[Chart]:
    return cube_sphere(_field, stretch=(1, 1.35, 1))


def paint(points: np.ndarray, texel: float) -> np.ndarray:
    turn, y = np.arctan2(points[:, 0], points[:, 2]) / (2 * np.pi), points[:, 1]
    grain = noise(points, 7, 610, octaves=3)
    clay = mix(rgb("d98145"), rgb("c96f38"), ramp(grain, -1.5, 1.5))
    black = mix(rgb("1f1815"), rgb("2a201b"), ramp(grain, -1.5, 1.5))
    around = 2 * np.pi * _PROFILE(np.clip(y, -0.6, 0.6))

    dark = [_tongues(turn, y, around), _meander(turn, y, texel), _frieze(turn, y, around), _waves(turn, y, around)]
    dark += [_rays(turn, y, around)]
    for edge in (0.155, 0.125, -0.165, -0.185):
        dark.append(np.abs(y - edge) - 0.0045)
    dark += [0.452 - y, y + 0.445]  # lip and foot
    colour = mix(clay, black, inside(np.minimum.reduce(dark), texel))
    light = _scales(turn, y, around)
    return mix(colour, clay, inside(light, texel))


def _cell(turn: np.ndarray, count: int, around: np.ndarray) -> np.ndarray:
    """Distance from the middle of the nearest of ``count`` repetitions, to the right positive."""
    return (np.mod(turn * count + 0.5, 1) - 0.5) * around / count


def _tongues(turn: np.ndarray, y: np.ndarray, around: np.ndarray) -> np.ndarray:
    """Drops that hang from the lip down the neck."""
    half = 0.36 * around / _TONGUES
    across = np.abs(_cell(turn, _TONGUES, around))
    return np.where(y > 0.325, across - half, np.hypot(across, y - 0.325) - half) + np.where(y > 0.28, 0, 1)


def _meander(turn: np.ndarray, y: np.ndarray, texel: float) -> np.ndarray:
    """The key pattern on the shoulder; a picture of cells, whose distance is that to the nearest border of a cell."""
    cells = np.array([[letter == "1" for letter in row] for row in _KEY])
    top, bottom = 0.262, 0.165
    rows, columns = cells.shape
    row = (top - y) / (top - bottom) * rows
    column = np.mod(turn * _KEYS, 1) * columns
    i, j = np.floor(row).astype(int), np.floor(column).astype(int)
    inner = (i >= 0) & (i < rows)
    i, j = np.clip(i, 0, rows - 1), np.clip(j, 0, columns - 1)
    pitch = (top - bottom) / rows
    distance = np.full(len(y), 0.5 * pitch)
    fy, fx = row - np.floor(row), column - np.floor(column)
    for di, dj, gap in ((-1, 0, fy), (1, 0, 1 - fy), (0, -1, fx), (0, 1, 1 - fx)):
        other = cells[np.clip(i + di, 0, rows - 1), (j + dj) % columns]
        distance = np.where(other != cells[i, j], np.minimum(distance, gap * pitch), distance)
    return np.where(inner, np.where(cells[i, j], -distance, distance), 1)


def _fish(turn: np.ndarray, y: np.ndarray, around: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates in the frame of the nearest fish, which swims to the right: every second one is higher."""
    which = np.floor(turn * _FISH + 0.5)
    x, v = _cell(turn, _FISH, around), y + 0.015 - 0.042 * np.where(np.mod(which, 2) == 0, 1, -1)
    return x / _FISH_SIZE, v / _FISH_SIZE


def _frieze(turn: np.ndarray, y: np.ndarray, around: np.ndarray) -> np.ndarray:
    x, v = _fish(turn, y, around)
    bend = v + 0.9 * x**2 - 0.008
    body = np.hypot((x - 0.012) / 2.05, bend) - 0.043
    tail = np.maximum(np.abs(bend) - 0.050 + 0.85 * (x + 0.135), x + 0.070)
    tail = np.maximum(tail, np.maximum(-0.122 - x, 0.020 - np.abs(bend) - 0.5 * (x + 0.110)))
    root = np.maximum(np.abs(bend) - 0.013, np.maximum(x + 0.05, -0.105 - x))
    fins = np.maximum(np.abs(np.abs(bend) - 0.046 + 0.25 * x) - 0.019, np.abs(x - 0.008) - 0.026 + 0.4 * np.abs(bend))
    return _FISH_SIZE * np.minimum(np.minimum(body, root), np.minimum(tail, fins))


def _scales(turn: np.ndarray, y: np.ndarray, around: np.ndarray) -> np.ndarray:
    """What is scratched out of the black: eye, gill and scales of the fish."""
    x, v = _fish(turn, y, around)
    bend = v + 0.9 * x**2 - 0.008
    body = np.hypot((x - 0.012) / 2.05, bend) - 0.043
    eye = np.abs(np.hypot(x - 0.067, bend - 0.010) - 0.0105) - 0.0038
    gill = np.maximum(np.abs(np.hypot(x - 0.078, bend) - 0.040) - 0.0036, x - 0.05)
    scales = np.full(len(x), 1.0)
    for start in (-0.052, -0.026, 0.0):
        arc = np.abs(np.hypot(x - start + 0.018, 0.75 * bend) - 0.030) - 0.0033
        scales = np.minimum(scales, np.where(x > start - 0.008, arc, 1))
    return _FISH_SIZE * np.maximum(np.minimum(np.minimum(eye, gill), scales), body + 0.007)


def _waves(turn: np.ndarray, y: np.ndarray, around: np.ndarray) -> np.ndarray:
    """The running dog below the fish: curls that lean over a black ground."""
    x = _cell(turn, _WAVES, around)
    half = 0.5 * around / _WAVES
    v = y + 0.228
    curl = np.hypot(x, v)
    crest = np.minimum(curl - 0.026, np.maximum(v + 0.006, -half - x))
    crest = np.where(v < 0, np.minimum(crest, np.abs(v + 0.018) - 0.012), crest)
    hollow = np.hypot(x - 0.010, v + 0.002) - 0.0125
    return np.maximum(np.where(np.abs(v + 0.004) < 0.034, crest, 1), -hollow)


def _rays(turn: np.ndarray, y: np.ndarray, around: np.ndarray) -> np.ndarray:
    """Slender triangles that rise from the foot."""
    half = 0.42 * around / _RAYS * ramp(y, -0.275, -0.44) ** 0.8
    return np.where((y < -0.275) & (y > -0.46), np.abs(_cell(turn, _RAYS, around)) - half, 1)


def _field(points: np.ndarray) -> np.ndarray:
    radius = _PROFILE(np.clip(points[:, 1], -0.6, 0.6))
    side = 0.8 * (np.hypot(points[:, 0], points[:, 2]) - radius)
    return cut(side, np.abs(points[:, 1]) - 0.5, 0.025)

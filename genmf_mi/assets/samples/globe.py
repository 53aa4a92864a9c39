"""A globe with a flat spot to stand on: continents, ice and a graticule on a perfectly round ball.

Longitude 0 faces +z, 90° E faces +x.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.ndimage import map_coordinates

from genmf_mi.assets.samples.charts import Chart, cube_sphere
from genmf_mi.assets.samples.coastlines import PER_DEGREE, blurred, land
from genmf_mi.assets.samples.pattern import cut, inside, mix, noise, ramp, rgb

_RADIUS = 0.5
_FOOT = -0.46
_STEP = np.pi / 6  # of the graticule


def charts() -> list[Chart]:
    return cube_sphere(_field)


def paint(points: np.ndarray, texel: float) -> np.ndarray:
    longitude = np.arctan2(points[:, 0], points[:, 2])
    latitude = np.arctan2(points[:, 1], np.hypot(points[:, 0], points[:, 2]))
    # Coasts wander by about a degree, so that the straight edges of the outlines disappear.
    east, north = (0.011 * noise(points, 16, seed, octaves=2) for seed in (210, 220))
    where = longitude + east / np.maximum(np.cos(latitude), 0.15), latitude + north
    shore = _sample(land(), *where)
    near = _sample(_surroundings(), *where)
    grain = noise(points, 9, 230, octaves=3)

    sea = mix(rgb("1b4f86"), rgb("153f70"), ramp(grain, -1.5, 1.5))
    sea = mix(sea, rgb("0d2c55"), ramp(near, 0.12, 0.5))
    ground = _ground(np.degrees(latitude), np.degrees(longitude), grain)

    across = np.abs(longitude - _STEP * np.round(longitude / _STEP)) * np.cos(latitude)
    along = np.abs(latitude - _STEP * np.round(latitude / _STEP))
    meridian = np.where(np.abs(latitude) < np.radians(76), _RADIUS * across, 1) - 0.005
    parallel = _RADIUS * along - np.where(np.abs(latitude) < 0.1, 0.0065, 0.005)
    line = inside(np.minimum(meridian, np.where(np.abs(latitude) < 1.3, parallel, 1)), texel)
    sea = mix(sea, rgb("79addf"), line)
    ground = mix(ground, ground * 0.72, line)
    return mix(sea, ground, ramp(shore, 0.35, 0.65))


@cache
def _surroundings() -> np.ndarray:
    """How much of the two degrees around is land, as :func:`land`."""
    return blurred(land(), 1.1 * PER_DEGREE)


def _ground(latitude: np.ndarray, longitude: np.ndarray, grain: np.ndarray) -> np.ndarray:
    """Forest, steppe, desert and ice by latitude."""
    wander = latitude + 3 * grain
    colour = mix(rgb("a9c56c"), rgb("bcd07c"), ramp(grain, -1.5, 1.5))
    drought = np.exp(-(((np.abs(wander) - 23) / 8) ** 2)) * (0.55 + 0.45 * ramp(np.abs(longitude - 15), 65, 40))
    colour = mix(colour, rgb("ecd79c"), drought)
    colour = mix(colour, rgb("d8d4b4"), ramp(np.abs(wander), 52, 66))
    greenland = (longitude > -74) & (longitude < -15) & (latitude > 59) & (latitude - 0.55 * (longitude + 45) > 59)
    ice = np.where((latitude < -60) | greenland, 1, ramp(wander, 72, 77))
    return mix(colour, rgb("f7fafc"), ice)


def _sample(grid: np.ndarray, longitude: np.ndarray, latitude: np.ndarray) -> np.ndarray:
    rows = (90 - np.degrees(latitude)) * PER_DEGREE - 0.5
    columns = (180 + np.degrees(longitude)) * PER_DEGREE - 0.5
    columns = np.mod(columns, grid.shape[1])
    return map_coordinates(grid, [np.clip(rows, 0, len(grid) - 1), columns], order=1, mode="grid-wrap")


def _field(points: np.ndarray) -> np.ndarray:
    return cut(np.linalg.norm(points, axis=-1) - _RADIUS, _FOOT - points[:, 1], 0.03)

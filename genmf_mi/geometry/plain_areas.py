"""Where an object has no texture: such areas should stay as they are, whatever the relief beside them needs."""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

RADIUS_MM = 6.0
"""An area is plain where the brightness within this distance differs by :data:`PLAIN_CONTRAST` at most."""
PLAIN_CONTRAST = 0.06
"""Of the sRGB-encoded brightness."""
PLAIN_CAP_MM = 0.06
"""Largest relief on plain areas, a third of a layer of a print."""
RAMP_MM = 3.0
"""Width of the strip beside a plain area in which the relief grows to its cap; the texture is as far away again."""
GROUPS_PER_RADIUS = 6
"""Points are grouped in cubes of this share of the radius: what lies within a radius is known that exactly."""


def brightness_range(points: np.ndarray, brightness: np.ndarray, radius: float) -> np.ndarray:
    """``[V]``: the largest less the smallest of ``brightness [V]`` within ``radius`` of each of ``points [V,3]``."""
    cells = np.floor(points / (radius / GROUPS_PER_RADIUS)).astype(np.int64)
    _, group = np.unique(cells, axis=0, return_inverse=True)
    group = group.ravel()
    count = group.max() + 1
    centre = np.stack([np.bincount(group, x, count) for x in points.T], axis=1) / np.bincount(group)[:, None]
    low, high = np.full(count, np.inf), np.full(count, -np.inf)
    np.minimum.at(low, group, brightness)
    np.maximum.at(high, group, brightness)
    lowest, highest = low.copy(), high.copy()
    pairs = KDTree(centre).query_pairs(radius, output_type="ndarray")
    for one, other in (pairs.T, pairs.T[::-1]):
        np.minimum.at(lowest, one, low[other])
        np.maximum.at(highest, one, high[other])
    return (highest - lowest)[group]


def is_plain(points_mm: np.ndarray, brightness: np.ndarray) -> np.ndarray:
    """``bool [V]``: whether there is no texture within :data:`RADIUS_MM` of ``points_mm [V,3]``.

    brightness: ``[V]``, sRGB-encoded; or ``[V,K]``, several things that are seen as changes of it.
    """
    each = brightness[:, None] if brightness.ndim == 1 else brightness
    ranges = [brightness_range(points_mm, signal, RADIUS_MM) for signal in each.T]
    return np.max(ranges, axis=0) <= PLAIN_CONTRAST


def relief_cap(points_mm: np.ndarray, brightness: np.ndarray, cap_mm: float) -> np.ndarray:
    """``[V]`` mm: ``cap_mm`` on textured areas, at most :data:`PLAIN_CAP_MM` on plain ones, a ramp between them.

    An object that is plain all over keeps its cap: what stands out of it is not its paint.

    brightness: as for :func:`is_plain`.
    """
    plain = is_plain(points_mm, brightness)
    if plain.all() or not plain.any():
        return np.full(len(points_mm), cap_mm)
    distance, _ = KDTree(points_mm[plain]).query(points_mm, distance_upper_bound=RAMP_MM)
    share = np.minimum(distance / RAMP_MM, 1.0)
    low = min(PLAIN_CAP_MM, cap_mm)
    return low + share * (cap_mm - low)

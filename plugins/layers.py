from __future__ import annotations  # Delayed parsing of type annotations

from functools import lru_cache

import drjit as dr
import mitsuba as mi
import numpy as np

SLOPES = np.linspace(-84, 84, 43)
"""Angle of the smooth normal above the layers, in degrees."""
VIEWS = np.linspace(-180, 180, 73)
"""Angle of the view direction above the layers, in the plane of the smooth
normal and the build direction, in degrees."""
NORMALS = np.linspace(-90, 90, 16)
"""Angle of the normals of the profile above the layers, in degrees: 0 on the
side of a bead, 90 on the tread of a step, -90 under an overhang."""

SEGMENTS = 12
"""Of the side of a bead."""
NEIGHBOURS = 6
"""Beads above and below the one that is looked at."""
RAYS = 200
"""For each pair of slope and view, over the height of one layer."""


def profile(slope: float, bulge: float) -> np.ndarray:
    """
    The outline of a stack of beads whose sides follow a surface of ``slope``
    (radians), from below to above: points ``[P,2]`` (outward, up), in units of
    the layer height. A side is half an ellipse of depth ``bulge``; what lies
    between two of them is flat.
    """
    angle = np.linspace(-np.pi / 2, np.pi / 2, SEGMENTS + 1)
    layer = np.arange(-NEIGHBOURS, NEIGHBOURS + 1)[:, None]
    outward = -layer * np.tan(slope) + bulge * (np.cos(angle) - 1)
    up = layer + np.sin(angle) / 2
    return np.stack([outward, up], axis=-1).reshape(-1, 2)


@lru_cache(maxsize=4)
def visible_normals(bulge: float) -> np.ndarray:
    """
    The share of what is seen that has each of the :data:`NORMALS`, by
    :data:`SLOPES` and :data:`VIEWS`: ``[43,73,16]``, sums of 1.

    Parallel rays are cast at one period of the profile. Views from behind the
    smooth surface show what the nearest view from its front does.
    """
    views = np.radians(VIEWS)
    table = np.zeros((len(SLOPES), len(VIEWS), len(NORMALS)))
    for row, slope in zip(table, np.radians(SLOPES)):
        in_front = np.cos(views - slope) > 0.02
        row[in_front] = _seen(slope, bulge, views[in_front])
        turn = np.abs(np.angle(np.exp(1j * (views[:, None] - views[in_front][None]))))
        row[:] = row[in_front][turn.argmin(axis=1)]
    return table


def _seen(slope: float, bulge: float, views: np.ndarray) -> np.ndarray:
    """:func:`visible_normals` of one slope, for views ``[N]`` in radians."""
    points = profile(slope, bulge)
    edges = np.diff(points, axis=0)
    points, edges = points[:-1], edges
    angle = np.arctan2(-edges[:, 0], edges[:, 1])
    towards = np.stack([np.cos(views), np.sin(views)])  # [2,N]
    across = np.stack([-np.sin(views), np.cos(views)])
    start, length = (points @ across).T, (edges @ across).T  # [N,P-1]
    start_depth, depth = (points @ towards).T, (edges @ towards).T
    facing = np.cos(angle - views[:, None]) > 1e-9

    period = np.abs(across[1] - across[0] * np.tan(slope))
    rays = ((np.arange(RAYS) + 0.5) / RAYS - 0.5) * period[:, None]
    share = (rays[..., None] - start[:, None]) / np.where(length == 0, np.nan, length)[:, None]
    hit = (share >= 0) & (share < 1) & facing[:, None]
    distance = np.where(hit, start_depth[:, None] + share * depth[:, None], -np.inf)
    first = distance.argmax(axis=-1)  # [N,RAYS]; the nearest is the farthest towards the viewer

    # Split between the two nearest of the tabulated normals
    place = np.interp(np.degrees(angle), NORMALS, np.arange(len(NORMALS)))[first]
    found = np.isfinite(np.take_along_axis(distance, first[..., None], axis=-1)[..., 0])
    below = np.minimum(place.astype(int), len(NORMALS) - 2)
    weights = np.zeros((len(views), len(NORMALS)))
    lane = np.broadcast_to(np.arange(len(views))[:, None], below.shape)
    np.add.at(weights, (lane, below), (1 - (place - below)) * found)
    np.add.at(weights, (lane, below + 1), (place - below) * found)
    return weights / weights.sum(axis=1, keepdims=True)


class Layers:
    """
    The normals that a stack of beads shows where layers are too fine to see.

    A filament print is a stack of beads. Its grey value is the average over the
    normals of the profile that the view reveals, not the grey value of the
    smooth surface that the beads follow; it does not depend on the height of
    the layers, only on the shape of the beads. What a view reveals is tabulated
    once (:func:`visible_normals`) and interpolated between slopes and views.
    """

    def __init__(self, bulge: float):
        self.table = mi.Float(visible_normals(bulge).astype(np.float32).ravel())

    def normals(self, n: mi.Vector3f, view: mi.Vector3f, up: mi.Vector3f, active: mi.Bool):
        """
        Pairs of a weight and a normal: the mix that replaces the smooth normal
        ``n`` seen from the direction ``view``, for layers stacked along ``up``.
        Differentiable with respect to ``n``.
        """
        rise = dr.dot(n, up)
        outward = dr.fma(-rise, up, n)
        width = dr.sqrt(dr.squared_norm(outward) + 1e-8)
        outward /= width

        i, x = self._cell(dr.rad2deg(dr.atan2(rise, width)), SLOPES)
        j, y = self._cell(dr.rad2deg(dr.atan2(dr.dot(view, up), dr.dot(view, outward))), VIEWS)

        weights = [mi.Float(0)] * len(NORMALS)
        for di, wi in ((0, 1 - x), (1, x)):
            for dj, wj in ((0, 1 - y), (1, y)):
                row = ((i + di) * len(VIEWS) + j + dj) * (len(NORMALS) // 4)
                for k in range(len(NORMALS) // 4):
                    entries = dr.gather(mi.Vector4f, self.table, row + k, active)
                    for m in range(4):
                        weights[4 * k + m] = dr.fma(wi * wj, entries[m], weights[4 * k + m])

        for weight, angle in zip(weights, np.radians(NORMALS)):
            yield weight, float(np.cos(angle)) * outward + float(np.sin(angle)) * up

    @staticmethod
    def _cell(angle: mi.Float, grid: np.ndarray) -> tuple[mi.UInt32, mi.Float]:
        """Index of the cell of ``grid`` that holds ``angle``, and the place in it from 0 to 1."""
        place = dr.clip((angle - grid[0]) / (grid[1] - grid[0]), 0, len(grid) - 1)
        index = mi.UInt32(dr.minimum(dr.floor(dr.detach(place)), len(grid) - 2))
        return index, place - index

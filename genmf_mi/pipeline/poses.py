"""Ways in which a part may stand on the print bed, from its shape alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from genmf_mi.core.config import Stand
from genmf_mi.core.frame import DIRECTIONS, UPRIGHT, Up
from genmf_mi.geometry.displacement_bounds import base
from genmf_mi.mesh.measures import face_areas, face_normals

LIKELIEST, LIKELY = 5, 0.03
"""So many of the ways in which the part comes to rest when it is dropped at random are candidates, each at least so
likely."""
SAME = float(np.cos(np.radians(10.0)))
"""Cosine of the angle within which two ways of standing are one."""
_RAREST, _TRIED = 0.002, 40
"""Least likelihood of a flat side to lie on, and how many are tried."""
_EXACT = float(np.cos(np.radians(0.5)))
"""Cosine of the angle within which a flat side is square to an axis."""
_LEVEL = 0.02, 0.01, 0.005
"""Shares of the longest side within which faces are levelled, one after the other."""
_CELLS = 50
"""Of the grid to which points are rounded before their hull is taken, which has thousands of faces otherwise."""


@dataclass(frozen=True)
class Pose:
    """How a part stands on the bed.

    name: of :data:`genmf_mi.core.frame.DIRECTIONS`, or ``tilted``. up: unit vector away from the bed.
    asked: for, in the settings.
    unsteady: nothing flat of it lies on the bed, see :func:`genmf_mi.geometry.displacement_bounds.base`.
    """

    name: str
    up: Up
    asked: str
    unsteady: bool


def pose(stand: Stand, vertices: np.ndarray, faces: np.ndarray) -> Pose:
    """The pose of a part, ``[V,3]`` and ``[F,3]`` in the normalised frame; for ``best``, from which it is looked for.

    ``auto`` leaves it upright if something flat of it lies on the bed then, or if it has no flat side.
    """
    name, up = stand, DIRECTIONS.get(stand, UPRIGHT)
    if stand in ("auto", "best"):
        name = "upright"
    unsteady = len(base(vertices, faces, up)) == 0
    if stand == "auto" and unsteady and (side := flat_side(vertices, faces)):
        (name, up), unsteady = side, False
    return Pose(name, up, stand, unsteady)


def flat_side(vertices: np.ndarray, faces: np.ndarray) -> tuple[str, Up] | None:
    """Name and direction of the likeliest way in which the part comes to rest on something flat, None if there is
    none."""
    for up, likelihood in _at_rest(vertices)[:_TRIED]:
        if likelihood < _RAREST:
            break
        level = _levelled(vertices, faces, up)
        name, near = named(level)
        direction = near if level @ np.array(near) > _EXACT else (float(level[0]), float(level[1]), float(level[2]))
        if len(base(vertices, faces, direction)):
            return name, direction
    return None


def candidates(vertices: np.ndarray) -> list[tuple[str, Up]]:
    """``upright`` first, then the likeliest ways in which a body of these points ``[V,3]`` comes to rest."""
    ups = [np.array(UPRIGHT)]
    for up, likelihood in _at_rest(vertices):
        if likelihood >= LIKELY and len(ups) <= LIKELIEST and all(up @ other < SAME for other in ups):
            ups.append(up)
    return [named(up) for up in ups]


def named(up: np.ndarray) -> tuple[str, Up]:
    """The direction of the six that ``up`` is within ten degrees of, or the same as ``tilted``."""
    for name, direction in DIRECTIONS.items():
        if up @ np.array(direction) > SAME:
            return name, direction
    x, y, z = (float(k) for k in up / np.linalg.norm(up))
    return "tilted", (x, y, z)


def _at_rest(vertices: np.ndarray) -> list[tuple[np.ndarray, float]]:
    """What points up as a body of these points ``[V,3]`` comes to rest, and how likely, the likeliest first; to within
    a few degrees."""
    from trimesh import PointCloud, poses

    untyped: Any = poses
    cell = np.ptp(vertices, axis=0).max() / _CELLS
    points = np.unique((vertices / cell).astype(np.int64), axis=0) * cell
    found: tuple[np.ndarray, np.ndarray] = untyped.compute_stable_poses(PointCloud(points).convex_hull)
    likeliest = sorted(zip(*found, strict=True), key=lambda each: -each[1])
    return [(turn[2, :3], float(likelihood)) for turn, likelihood in likeliest]


def _levelled(vertices: np.ndarray, faces: np.ndarray, up: np.ndarray) -> np.ndarray:
    """``up``, turned so that what lies on the bed, about, lies on it exactly."""
    normals, areas = face_normals(vertices, faces), face_areas(vertices, faces)
    longest = np.ptp(vertices, axis=0).max()
    for share in _LEVEL:
        height = vertices @ up
        down = (normals @ up < -SAME) & (height[faces].max(axis=1) - height.min() < share * longest)
        if not down.any():
            break
        mean = -(areas[down, None] * normals[down]).sum(axis=0)
        up = mean / np.linalg.norm(mean)
    return up

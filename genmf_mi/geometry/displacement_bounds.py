"""How far each vertex may move: limited by the cap, wall thickness, narrow gaps, curvature and contact with the bed.

Heights are taken along the normals of the initial surface. Neighbouring vertices then cannot run into each other as
long as the height stays below the radius at which their normals meet, and opposite walls cannot meet as long as each
leaves the other its half.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from genmf_mi.core.frame import UPRIGHT, Up
from genmf_mi.mesh.measures import face_areas, face_normals

CURVATURE_LIMIT = 1.0
"""Share of the radius of curvature that relief may use up."""
TANGENTIAL_LIMIT = 0.5
"""Share of the shortest edge at a vertex that it may move across its normal."""
THIN_FEATURE_LIMIT = 0.05
"""Share of its lateral thickness that relief may take from a limb: more shows in the silhouette, which the gradient
does not see."""
BED_CONTACT_LIMIT = 0.5
"""Share of its height above the bed that a vertex may move. What stands on the bed stays on it, and nothing comes to
lie below; a stress stage would otherwise lift all feet but one, so that the clamp loads them less."""
BASE_BAND = 0.005
"""Faces within this share of the height from the lowest point, looking down, are the base."""


@dataclass(frozen=True)
class DisplacementBounds:
    """How far each vertex may move from the initial surface: three ``[V]``, one unit, none negative.

    inward, outward: against and along the normal. tangential: across it.
    """

    inward: np.ndarray
    outward: np.ndarray
    tangential: np.ndarray

    def capped(self, cap: float | np.ndarray) -> DisplacementBounds:
        """Motion along and across the normal together within ``cap``, one for all vertices or ``[V]``."""
        inward, outward = np.minimum(self.inward, cap), np.minimum(self.outward, cap)
        tangential = np.minimum(self.tangential, 0.5 * np.minimum(inward, outward))
        upright = np.sqrt(np.maximum(cap**2 - tangential**2, 0))
        return DisplacementBounds(np.minimum(inward, upright), np.minimum(outward, upright), tangential)


def displacement_bounds(
    vertices: np.ndarray,
    faces: np.ndarray,
    normals: np.ndarray,
    cap: float | np.ndarray,
    wall: float,
    free_ray_distance: Callable[[np.ndarray, np.ndarray], np.ndarray],
    up: Up = UPRIGHT,
) -> DisplacementBounds:
    """The bounds of each vertex, at most ``cap``.

    Args:
        vertices, normals: ``[V,3]``, the normals of unit length. faces: ``[F,3]``.
        cap: the largest relief, one for all vertices or ``[V]``. wall: the wall thickness that must remain. Both in the
            unit of the vertices.
        free_ray_distance: from points and unit directions ``[N,3]`` to the distance ``[N]`` of the next surface, inf
            where there is none.
        up: unit vector away from the print bed.
    """
    convex, concave = curvatures(vertices, faces, normals)
    inward = np.minimum(cap, CURVATURE_LIMIT / np.maximum(convex, 1e-9))
    outward = np.minimum(cap, CURVATURE_LIMIT / np.maximum(concave, 1e-9))
    # Each of two opposite walls may use less than half of what lies between them
    through = free_ray_distance(vertices, -normals)
    inward = np.minimum(inward, 0.45 * np.maximum(through - wall, 0))
    outward = np.minimum(outward, 0.3 * free_ray_distance(vertices, normals))
    thin = THIN_FEATURE_LIMIT * lateral_thickness(vertices, normals, through, free_ray_distance)
    contact = BED_CONTACT_LIMIT * _height(vertices, up)
    inward, outward = (np.minimum(x, np.minimum(thin, contact)) for x in (inward, outward))
    inward, outward = (_spread_minimum(x, faces) for x in (inward, outward))
    pinned = base(vertices, faces, up)
    inward[pinned] = outward[pinned] = 0
    return DisplacementBounds(inward, outward, TANGENTIAL_LIMIT * _shortest_edge(vertices, faces)).capped(cap)


def curvatures(vertices: np.ndarray, faces: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The largest normal curvature along the edges at each vertex, of convex and of concave bends: two ``[V]``, not
    negative. The first limits motion inwards, the second motion outwards."""
    i, j = faces[:, [0, 1, 2]].ravel(), faces[:, [1, 2, 0]].ravel()
    along = vertices[j] - vertices[i]
    curvature = np.einsum("nk,nk->n", normals[j] - normals[i], along) / np.maximum((along**2).sum(axis=1), 1e-20)
    convex, concave = np.zeros(len(vertices)), np.zeros(len(vertices))
    for end in (i, j):
        np.maximum.at(convex, end, curvature)
        np.maximum.at(concave, end, -curvature)
    return convex, concave


def lateral_thickness(
    vertices: np.ndarray,
    normals: np.ndarray,
    through: np.ndarray,
    free_ray_distance: Callable[[np.ndarray, np.ndarray], np.ndarray],
    directions: int = 4,
) -> np.ndarray:
    """The width of the body behind each vertex, ``[V]``: its shortest extent along lines parallel to the surface.

    Measured half-way to the opposite wall, which is ``through [V]`` away, along ``directions`` lines. A leg or a handle
    is as wide as it is thick; a plate or the wall of a cup is thin but wide.
    """
    middle = vertices - 0.5 * np.where(np.isfinite(through), through, 0.0)[:, None] * normals
    helper = np.eye(3)[np.abs(normals).argmin(axis=1)]
    across = np.cross(normals, helper)
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-20)
    other = np.cross(normals, across)
    width = np.full(len(vertices), np.inf)
    for angle in np.arange(directions) * np.pi / directions:
        along = np.cos(angle) * across + np.sin(angle) * other
        width = np.minimum(width, free_ray_distance(middle, along) + free_ray_distance(middle, -along))
    return width


def base(vertices: np.ndarray, faces: np.ndarray, up: Up = UPRIGHT) -> np.ndarray:
    """Indices of the vertices of the flat base; empty if it covers less than 2 % of the footprint's box.

    up: unit vector away from the bed.
    """
    area, height = face_areas(vertices, faces), _height(vertices, up)
    down = -(face_normals(vertices, faces) @ np.array(up))
    flat = (down > 0.98) & (height[faces].max(axis=1) < BASE_BAND * height.max())
    level = vertices - height[:, None] * np.array(up)
    footprint = np.prod(np.sort(np.ptp(level, axis=0))[1:])
    return np.unique(faces[flat]) if area[flat].sum() > 0.02 * footprint else np.empty(0, np.int64)


def _height(vertices: np.ndarray, up: Up) -> np.ndarray:
    """``[V]`` above the lowest vertex."""
    along = vertices @ np.array(up)
    return along - along.min()


def _shortest_edge(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """``[V]`` length of the shortest edge at each vertex."""
    shortest = np.full(len(vertices), np.inf)
    for a, b in ((0, 1), (1, 2), (2, 0)):
        length = np.linalg.norm(vertices[faces[:, a]] - vertices[faces[:, b]], axis=1)
        np.minimum.at(shortest, faces[:, a], length)
        np.minimum.at(shortest, faces[:, b], length)
    return shortest


def _spread_minimum(x: np.ndarray, faces: np.ndarray, rounds: int = 2) -> np.ndarray:
    """The minimum over neighbours, ``rounds`` times: a tight spot limits its surroundings too."""
    for _ in range(rounds):
        lowest = x[faces].min(axis=1)
        x = x.copy()
        for k in range(3):
            np.minimum.at(x, faces[:, k], lowest)
    return x

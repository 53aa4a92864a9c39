"""The nearest point of a surface, for many points at once."""

from __future__ import annotations

import igl
import numpy as np

from genmf_mi.mesh import measures

REACH = 0.02
"""How far :meth:`Nearest.on_agreeing_faces` looks for another face, as a share of the longest side of the surface."""


def closest_points(
    points: np.ndarray, vertices: np.ndarray, faces: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Face index ``[N]``, closest point ``[N,3]`` and distance ``[N]`` of ``points [N,3]`` to a surface."""
    squared, index, closest = igl.point_mesh_squared_distance(*map(np.ascontiguousarray, (points, vertices, faces)))
    return np.asarray(index), np.asarray(closest), np.sqrt(np.asarray(squared))


def distance_to_surface(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Distance ``[N]`` of ``points [N,3]`` to a surface."""
    return closest_points(points, vertices, faces)[2]


class Nearest:
    """Bounding-volume trees: one of all faces, and one per axis direction of the faces whose normals point that way."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        self.vertices, self.faces = np.ascontiguousarray(vertices), np.ascontiguousarray(faces)
        corners = vertices[faces]
        normals, areas = measures.face_normals(vertices, faces), measures.face_areas(vertices, faces)
        outwards = np.einsum("n,nk,nk->", areas, normals, corners.mean(axis=1) - corners.reshape(-1, 3).mean(axis=0))
        self.normals = normals if outwards >= 0 else -normals  # a file that is inside out
        self.reach = REACH * np.ptp(corners.reshape(-1, 3), axis=0).max()
        self.trees: dict[int, tuple[igl.AABB, np.ndarray]] = {}

    def find(self, points: np.ndarray, axis: int = -1) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Face index ``[N]``, closest point ``[N,3]`` and distance ``[N]`` of ``points [N,3]``.

        Args:
            axis: 0..5 considers only faces that point towards +x, +y, +z, -x, -y, -z; the distance is infinite if there
                are none.
        """
        if axis not in self.trees:
            everything = np.arange(len(self.faces))
            towards = self.normals[:, axis % 3] * (1 if axis < 3 else -1)
            members = everything if axis < 0 else everything[towards > 0]
            tree = igl.AABB()
            if len(members):
                tree.init(self.vertices, self.faces[members])
            self.trees[axis] = tree, members
        tree, members = self.trees[axis]
        if len(members) == 0:
            return np.zeros(len(points), np.int64), points, np.full(len(points), np.inf)
        squared, index, closest = map(
            np.asarray, tree.squared_distance(self.vertices, self.faces[members], np.ascontiguousarray(points))
        )
        return members[index], closest, np.sqrt(squared)

    def on_agreeing_faces(
        self, points: np.ndarray, normals: np.ndarray, index: np.ndarray, closest: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The result of :meth:`find`, moved to faces that point the same way as ``normals [N,3]``.

        An entry of ``index [N]`` and ``closest [N,3]`` changes where its face points against the normal and another
        face, within :data:`REACH`, points along with it.
        """
        facing = np.einsum("nk,nk->n", self.normals[index], normals)
        against = np.flatnonzero(facing < 0)
        index, closest = index.copy(), closest.copy()
        axes = np.abs(normals[against]).argmax(axis=1)
        axes += 3 * (normals[against, axes] < 0)
        for axis in np.unique(axes):
            rows = against[axes == axis]
            other, point, distance = self.find(points[rows], int(axis))
            better = (distance < self.reach) & (np.einsum("nk,nk->n", self.normals[other], normals[rows]) > 0)
            index[rows[better]], closest[rows[better]] = other[better], point[better]
        return index, closest


def barycentric(corners: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Barycentric coordinates ``[N,3]`` of ``points [N,3]`` on triangles ``corners [N,3,3]``.

    Points on collapsed triangles get the coordinates of a corner.
    """
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    offset = points - corners[:, 0]
    aa, ab, bb = (np.einsum("nk,nk->n", x, y) for x, y in ((first, first), (first, second), (second, second)))
    oa, ob = np.einsum("nk,nk->n", offset, first), np.einsum("nk,nk->n", offset, second)
    area = aa * bb - ab * ab
    safe = np.where(area > 0, area, 1)
    v, w = np.where(area > 0, (bb * oa - ab * ob) / safe, 0), np.where(area > 0, (aa * ob - ab * oa) / safe, 0)
    weights = np.clip(np.stack([1 - v - w, v, w], axis=1), 0, 1)
    return weights / weights.sum(axis=1, keepdims=True)

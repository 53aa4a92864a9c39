"""A tetrahedral mesh, and what follows from its cells alone: volumes, quality, boundary, components."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

FACES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])
"""Faces of a tetrahedron, outward, face i opposite to corner i."""


@dataclass(frozen=True)
class TetMesh:
    """points: float64 ``[N,3]``; cells: int64 ``[T,4]``, positively oriented."""

    points: np.ndarray
    cells: np.ndarray

    @property
    def volumes(self) -> np.ndarray:
        """Signed volumes ``[T]``."""
        a, b, c, d = (self.points[self.cells[:, i]] for i in range(4))
        return np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) / 6

    @property
    def quality(self) -> np.ndarray:
        """Mean ratio 12 (3V)^(2/3) / Σ ℓ² of each cell, ``[T]``; 1 for a regular tetrahedron."""
        corner = self.points[self.cells]
        squares = sum(((corner[:, i] - corner[:, j]) ** 2).sum(axis=1) for i in range(4) for j in range(i))
        volume = self.volumes
        return np.sign(volume) * 12 * (3 * np.abs(volume)) ** (2 / 3) / squares

    def boundary(self) -> np.ndarray:
        """Outward boundary triangles ``[B,3]``."""
        faces, count, _ = _unique_faces(self.cells)
        return self.cells[:, FACES].reshape(-1, 3)[faces[count == 1]]

    def with_points(self, points: np.ndarray) -> TetMesh:
        """The same cells at other points ``[N,3]``."""
        return TetMesh(np.ascontiguousarray(points, dtype=np.float64), self.cells)

    def oriented(self) -> TetMesh:
        """The same tetrahedra, those of negative volume turned round."""
        flip = self.volumes < 0
        return TetMesh(self.points, np.where(flip[:, None], self.cells[:, [0, 2, 1, 3]], self.cells))


def compact(points: np.ndarray, cells: np.ndarray) -> TetMesh:
    """The mesh of ``cells [T,4]`` without the points that none of them uses."""
    used, cells = np.unique(cells, return_inverse=True)
    return TetMesh(points[used], cells.reshape(-1, 4))


def largest_component(mesh: TetMesh) -> tuple[TetMesh, list[float]]:
    """The largest component held together by shared faces, and the volumes of those left out, largest first.

    Components that touch in an edge or a point only are separate: such a hinge carries no moment.
    """
    import scipy.sparse as sp
    from scipy.sparse.csgraph import connected_components

    faces, count, partner = _unique_faces(mesh.cells)
    shared = count == 2
    a, b = faces[shared] // 4, partner[shared] // 4
    size = len(mesh.cells)
    graph = sp.coo_matrix((np.ones(len(a), dtype=bool), (a, b)), shape=(size, size))
    components, component = connected_components(graph, directed=False)
    volume = np.bincount(component, mesh.volumes, components)
    largest = int(volume.argmax())
    rest = sorted(map(float, np.delete(volume, largest)), reverse=True)
    return compact(mesh.points, mesh.cells[component == largest]), rest


def _unique_faces(cells: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Each face once: where it first occurs, as ``4·cell + corner``, how often, and where it last occurs."""
    corner = np.sort(cells[:, FACES].reshape(-1, 3), axis=1)
    size = int(cells.max()) + 1
    key = (corner[:, 0] * size + corner[:, 1]) * size + corner[:, 2]
    order = np.argsort(key, kind="stable")
    start = np.flatnonzero(np.r_[True, np.diff(key[order]) != 0])
    stop = np.r_[start[1:], len(order)]
    return order[start], stop - start, order[stop - 1]

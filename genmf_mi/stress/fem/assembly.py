"""Linear (P1) finite elements on tetrahedra, assembled edge by edge.

A matrix of P1 elements has one entry per node and one per edge and direction. With the edges numbered once, every
assembly is a handful of ``bincount``: twenty times faster than a general assembler, which would take longer than the
rest of a simulation. ``skfem`` gives the same matrices to round-off, see the tests.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
import scipy.sparse as sp

from genmf_mi.stress.fem.shape_functions import ShapeFunctions, triangle_areas
from genmf_mi.stress.fem.tet_mesh import TetMesh

_PAIRS = np.array([(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)])
"""Corners of the six edges of a cell."""


class P1(ShapeFunctions[np.ndarray]):
    """P1 elements on one mesh, in millimetres.

    volumes: ``[T]``, mm³. gradients: ``[T,4,3]``, of the four shape functions, 1/mm.
    boundary: ``[B,3]``, outward triangles. areas: ``[B]``, mm².
    """

    def __init__(self, mesh: TetMesh) -> None:
        super().__init__(mesh.points, mesh.cells)
        self.mesh = mesh

    def at(self, points: np.ndarray) -> P1:
        """The elements of the same cells with their nodes elsewhere, ``[N,3]`` in mm; what depends on the cells alone
        is shared."""
        other = P1(self.mesh.with_points(points))
        other.__dict__ |= {"boundary": self.boundary, "_edges": self._edges, "_pattern": self._pattern}
        return other

    @cached_property
    def boundary(self) -> np.ndarray:
        return self.mesh.boundary()

    @cached_property
    def areas(self) -> np.ndarray:
        return triangle_areas(self.points, self.boundary)

    @cached_property
    def _edges(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Ends of every edge (low, high), the edge of each pair of each cell ``[T,6]``, and whether its
        low end comes first."""
        ends = self.cells[:, _PAIRS]
        ordered = ends[..., 0] < ends[..., 1]
        key = np.where(ordered, ends[..., 0], ends[..., 1]) * self.nodes + np.where(ordered, ends[..., 1], ends[..., 0])
        order = np.argsort(key, axis=None, kind="stable")
        ranked = key.reshape(-1)[order]
        new = np.r_[True, ranked[1:] != ranked[:-1]]
        index = np.empty(key.size, dtype=np.int64)
        index[order] = np.cumsum(new) - 1
        low, high = np.divmod(ranked[new], self.nodes)
        return low, high, index.reshape(key.shape), ordered

    @cached_property
    def _pattern(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Row pointers, column indices, and the order that takes (diagonal, low→high, high→low) to rows."""
        low, high, _, _ = self._edges
        own = np.arange(self.nodes)
        rows, columns = np.concatenate([own, low, high]), np.concatenate([own, high, low])
        order = np.argsort(rows * self.nodes + columns, kind="stable")
        pointers = np.r_[0, np.cumsum(np.bincount(rows, minlength=self.nodes))]
        return pointers.astype(np.int32), columns[order].astype(np.int32), order

    def matrix(self, diagonal: np.ndarray, pairs: np.ndarray) -> sp.csr_matrix:
        """A symmetric matrix from element entries: ``diagonal [T,4]`` and ``pairs [T,6]`` (01 02 03 12 13 23)."""
        low, _, index, _ = self._edges
        own = np.bincount(self.cells.reshape(-1), diagonal.reshape(-1), self.nodes)
        off = np.bincount(index.reshape(-1), pairs.reshape(-1), len(low))
        pointers, columns, order = self._pattern
        return sp.csr_matrix((np.concatenate([own, off, off])[order], columns, pointers), (self.nodes, self.nodes))

    def stiffness(self) -> sp.csr_matrix:
        """∫ ∇u·∇v, mm."""
        g, v = self.gradients, self.volumes[:, None]
        first, second = _PAIRS.T
        return self.matrix(v * (g**2).sum(axis=2), v * np.einsum("tpi,tpi->tp", g[:, first], g[:, second]))

    def mass(self) -> sp.csr_matrix:
        """∫ u v, mm³."""
        v = self.volumes[:, None]
        return self.matrix(np.repeat(v / 10, 4, axis=1), np.repeat(v / 20, 6, axis=1))

    def boundary_mass(self) -> sp.csr_matrix:
        """∮ u v over the whole surface, mm²."""
        local = np.array([[2, 1, 1], [1, 2, 1], [1, 1, 2]]) / 12
        rows, columns = np.repeat(self.boundary, 3, axis=1), np.tile(self.boundary, (1, 3))
        entries = self.areas[:, None] * local.reshape(1, 9)
        shape = (self.nodes, self.nodes)
        return sp.csr_matrix((entries.reshape(-1), (rows.reshape(-1), columns.reshape(-1))), shape)

    def boundary_load(self) -> np.ndarray:
        """∮ v over the whole surface, ``[N]``, mm²."""
        return np.bincount(self.boundary.reshape(-1), np.repeat(self.areas / 3, 3), self.nodes)

    def elastic(
        self, lam: float, mu: float, spring: np.ndarray | None = None, stiffness: np.ndarray | None = None
    ) -> sp.bsr_matrix:
        """∫ λ div u div v + 2μ ε(u):ε(v), times the relative ``stiffness [T]`` of each cell, plus an isotropic nodal
        ``spring [N]`` in N/mm; in 3×3 blocks, N/mm."""
        low, _, index, ordered = self._edges
        pointers, columns, order = self._pattern
        blocks = np.empty((len(order), 3, 3))
        own, up, down = np.split(blocks, [self.nodes, self.nodes + len(low)])
        # One component after the other in memory, as all below is done by components
        g = np.ascontiguousarray(self.gradients.transpose(2, 1, 0))  # [3,4,T]
        vg = g * (self.volumes if stiffness is None else self.volumes * stiffness)
        cells, edge, ordered = self.cells.T.reshape(-1), index.T.reshape(-1), ordered.T
        first, second = _PAIRS.T
        shear_own = mu * (vg * g).sum(axis=0)
        shear = mu * sum(vg[i, first] * g[i, second] for i in range(3))
        for i in range(3):
            for j in range(i, 3):
                entries = (lam + mu) * vg[i] * g[j]
                # Of the pair in the order of its corners, which is transposed where the higher node comes first
                straight = lam * vg[i, first] * g[j, second] + mu * vg[j, first] * g[i, second]
                if i == j:
                    entries += shear_own
                    straight += shear
                else:
                    other = lam * vg[j, first] * g[i, second] + mu * vg[i, first] * g[j, second]
                    straight, reverse = np.where(ordered, straight, other), np.where(ordered, other, straight)
                    up[:, j, i] = down[:, i, j] = np.bincount(edge, reverse.reshape(-1), len(low))
                own[:, i, j] = own[:, j, i] = np.bincount(cells, entries.reshape(-1), self.nodes)
                up[:, i, j] = down[:, j, i] = np.bincount(edge, straight.reshape(-1), len(low))
        if spring is not None:
            own[:, range(3), range(3)] += spring[:, None]
        return sp.bsr_matrix((blocks[order], columns, pointers), (3 * self.nodes, 3 * self.nodes))

    def divergence_load(self, pressure: np.ndarray) -> np.ndarray:
        """∫ p div v for one pressure per cell ``[T]`` in MPa, ``[N,3]`` in N."""
        return self._load(pressure[:, None, None] * self.gradients)

    def stress_load(self, stress: np.ndarray) -> np.ndarray:
        """∫ σ:ε(v) for a symmetric stress per cell ``[T,3,3]`` in MPa, ``[N,3]`` in N."""
        return self._load(self.gradients @ stress)

    def _load(self, density: np.ndarray) -> np.ndarray:
        """The sum over the cells of ``density [T,4,3]`` times the volume, at each node, ``[N,3]``."""
        weighted = self.volumes[:, None, None] * density
        cells = self.cells.reshape(-1)
        return np.stack([np.bincount(cells, weighted[..., i].reshape(-1), self.nodes) for i in range(3)], axis=1)

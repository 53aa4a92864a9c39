"""Implicit diffusion on a graph: the linear operator behind large steps and behind the low-pass filter."""

from __future__ import annotations

import igl
import numpy as np
import torch
from cholespy import CholeskySolverF, MatrixType  # pyright: ignore[reportAttributeAccessIssue]  (compiled)
from scipy.sparse import coo_matrix, csr_matrix, diags
from torch import Tensor


def laplacian(cells: np.ndarray, count: int) -> csr_matrix:
    """The combinatorial Laplacian L (valence minus adjacency) ``[count,count]``.

    Args:
        cells: faces ``[F,3]`` of a mesh, or edges ``[E,2]`` of any other graph.
        count: number of vertices.
    """
    i, j = cells.ravel(), np.roll(cells, -1, axis=1).ravel()
    adjacency = coo_matrix((np.ones(2 * len(i)), (np.r_[i, j], np.r_[j, i])), shape=(count, count)).tocsr()
    adjacency.data[:] = 1
    return diags(np.asarray(adjacency.sum(axis=1)).ravel()).tocsr() - adjacency


def cotangent_laplacian(vertices: np.ndarray, faces: np.ndarray) -> csr_matrix:
    """The cotangent Laplacian, positive semidefinite, ``[V,V]``, without its negative weights.

    These come with obtuse triangles and would let a filter overshoot.
    """
    weights = igl.cotmatrix(vertices, faces).tocoo()
    across = (weights.row != weights.col) & (weights.data > 0)
    adjacency = coo_matrix((weights.data[across], (weights.row[across], weights.col[across])), weights.shape).tocsr()
    return diags(np.asarray(adjacency.sum(axis=1)).ravel()).tocsr() - adjacency


class ImplicitDiffusion:
    """x = (M + L)⁻¹ u with a diagonal M, differentiable; factorised once by cholespy, on the CPU or the GPU.

    Args:
        stiffness: L ``[V,V]``, with any factor in it. mass: the diagonal of M ``[V]``.
    """

    def __init__(self, stiffness: csr_matrix, mass: np.ndarray, device: str = "cpu") -> None:
        count = len(mass)
        matrix = (stiffness + diags(mass)).tocoo()
        rows, columns = (torch.as_tensor(x, dtype=torch.int32, device=device) for x in (matrix.row, matrix.col))
        values = torch.as_tensor(matrix.data, dtype=torch.float64, device=device)
        self._solver = CholeskySolverF(count, rows, columns, values, MatrixType.COO)
        self._matrix = torch.sparse_coo_tensor(
            torch.stack([rows, columns]).long(), values.float(), (count, count), check_invariants=False
        ).coalesce()

    @classmethod
    def large_steps(cls, cells: np.ndarray, count: int, smoothing: float, device: str = "cpu") -> ImplicitDiffusion:
        """(I + λL)⁻¹ with the combinatorial Laplacian. With u as the variable that is optimised, this is the
        preconditioner of *Large Steps in Inverse Rendering of Geometry* (Nicolet, Jacobson and Jakob, 2021).

        cells, count: as for :func:`laplacian`. smoothing: λ.
        """
        return cls(laplacian(cells, count) * smoothing, np.ones(count), device)

    def __call__(self, u: Tensor) -> Tensor:
        """``[V,k]`` to ``[V,k]``."""
        return _Solve.apply(u, self._solver)

    def inverse(self, x: Tensor) -> Tensor:
        """u = (M + L) x."""
        return self._matrix @ x


class _Solve(torch.autograd.Function):
    @staticmethod
    def forward(ctx, u: Tensor, solver: CholeskySolverF) -> Tensor:
        ctx.solver = solver
        return _solved(solver, u.detach())

    @staticmethod
    def backward(ctx, gradient: Tensor) -> tuple[Tensor, None]:
        return _solved(ctx.solver, gradient), None  # the matrix is symmetric: its adjoint is the same solve


def _solved(solver: CholeskySolverF, u: Tensor) -> Tensor:
    u = u.contiguous()
    x = torch.empty_like(u)
    solver.solve(u, x)
    return x

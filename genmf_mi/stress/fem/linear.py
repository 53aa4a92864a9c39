"""Conjugate gradients that either converge or say so."""

from __future__ import annotations

import numpy as np
import scipy.sparse.linalg as spl

from genmf_mi.core.errors import GenmfError


class SolveError(GenmfError):
    """A linear system did not converge; no field is returned."""


def jacobi(matrix) -> spl.LinearOperator:
    """The inverse of the diagonal, as a preconditioner."""
    inverse = 1.0 / matrix.diagonal()
    return spl.LinearOperator(matrix.shape, lambda x: inverse * x, dtype=np.float64)


def solve_spd(matrix, load, preconditioner, tolerance, guess=None, what="the system", most=2000):
    """Solve a symmetric positive definite system to a relative residual of ``tolerance``.

    Returns:
        The solution ``[N]`` and the number of iterations.

    Raises:
        SolveError: not converged within ``most`` iterations, or the result is not finite.
    """
    count = 0

    def tick(_):
        nonlocal count
        count += 1

    norm = np.linalg.norm(load)
    if norm == 0.0:
        return np.zeros_like(load), 0
    with np.errstate(all="ignore"):
        solution, _ = spl.cg(
            matrix, load, x0=guess, rtol=tolerance, atol=0.0, maxiter=most, M=preconditioner, callback=tick
        )
        residual = np.linalg.norm(load - matrix @ solution) / norm
    if not residual <= 10 * tolerance:
        raise SolveError(
            f"{what} did not converge: relative residual {residual:.1e} after {count} iterations, "
            f"wanted {tolerance:.0e}. The mesh may hang together by single points; try a smaller --edge-mm."
        )
    return solution, count

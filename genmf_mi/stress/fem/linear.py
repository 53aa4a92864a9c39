"""Conjugate gradients that either converge or raise."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.sparse.linalg as spl

from genmf_mi.core.errors import GenmfError


class SolveError(GenmfError):
    """A linear system did not converge; no field is returned."""


def jacobi(matrix: Any) -> spl.LinearOperator:
    """The inverse of the diagonal of a sparse matrix, as a preconditioner."""
    inverse = 1.0 / matrix.diagonal()
    return preconditioner_of(matrix, lambda x: inverse * x)


def preconditioner_of(matrix: Any, apply: Callable[[np.ndarray], np.ndarray]) -> spl.LinearOperator:
    """``apply`` as a preconditioner of the square ``matrix``."""
    constructor: Any = spl.LinearOperator  # its stub has the dtype twice
    return constructor(matrix.shape, matvec=apply, dtype=np.float64)


def solve_spd(
    matrix: Any,
    load: np.ndarray,
    preconditioner: spl.LinearOperator | None,
    tolerance: float,
    guess: np.ndarray | None = None,
    what: str = "the system",
    max_iterations: int = 2000,
) -> tuple[np.ndarray, int]:
    """Solve a symmetric positive definite system to a relative residual of ``tolerance``.

    Returns:
        The solution ``[N]`` and the number of iterations.

    Raises:
        SolveError: not converged within ``max_iterations`` iterations, or the result is not finite.
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
            matrix, load, x0=guess, rtol=tolerance, atol=0.0, maxiter=max_iterations, M=preconditioner, callback=tick
        )
        residual = np.linalg.norm(load - matrix @ solution) / norm
    if not residual <= 10 * tolerance:
        raise SolveError(
            f"{what} did not converge: relative residual {residual:.1e} after {count} iterations, "
            f"wanted {tolerance:.0e}. The mesh may hang together by single points; try a smaller --edge-mm."
        )
    return solution, count

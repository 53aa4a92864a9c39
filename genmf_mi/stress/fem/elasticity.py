"""Linear thermo-elasticity: div σ = 0 with σ = λ tr(ε) I + 2μ ε − β (T − T₀) I, β = (3λ + 2μ) α.

The body stands on a *soft clamp*: nodal springs of stiffness κ w(z) per volume, κ = E/ℓ², ℓ = δ/2, over the lowest
δ = ``clamp_fraction`` of its height. A rigid clamp is singular along its rim, where the maximum grows with every
refinement.
"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import scipy.sparse as sp

from genmf_mi.stress.fem.assembly import P1
from genmf_mi.stress.fem.linear import preconditioner_of, solve_spd
from genmf_mi.stress.fem.materials import Material
from genmf_mi.stress.fem.shape_functions import Array, ShapeFunctions, namespace

TOLERANCE = 1e-6
"""Relative residual of the equilibrium."""


def soft_clamp(height: Array, nodal_volume: Array, modulus_mpa: float, fraction: float) -> Array:
    """Spring stiffness of each node in N/mm, ``[N]``; arrays or tensors.

    w is 1 up to half of δ above the lowest node and falls to 0, smoothly, at 1.5 δ.

    Args:
        height: vertical coordinate of the nodes in mm, ``[N]``.
        nodal_volume: mm³, ``[N]``.
        fraction: δ as a fraction of the height of the body.
    """
    base = height.min()
    extent: Any = height.max() - base
    profile = clamp_profile((height - base) / extent, fraction)
    return modulus_mpa / (fraction * extent / 2) ** 2 * profile * nodal_volume


def clamp_profile(height: Array, fraction: float) -> Array:
    """w, 0..1, at ``height`` above the base as a fraction of that of the body; an array or a tensor."""
    x = (height / fraction - 0.5).clip(0.0, 1.0)
    return 1.0 - x * x * (3.0 - 2.0 * x)


def rigid_motions(points: np.ndarray) -> np.ndarray:
    """The six rigid body motions of ``points [N,3]`` as columns ``[3N,6]``. The coarse levels of a multigrid must
    represent them exactly."""
    x = points - points.mean(axis=0)
    motions = np.zeros((len(x), 3, 6))
    motions[:, :, :3] = np.eye(3)
    for i in range(3):
        motions[:, :, 3 + i] = np.cross(np.eye(3)[i], x)
    return motions.reshape(-1, 6)


def multigrid(matrix: sp.bsr_matrix, points: np.ndarray) -> sp.linalg.LinearOperator:
    """Smoothed-aggregation multigrid (pyamg) for an elastic matrix in 3×3 blocks, as a preconditioner: one V-cycle.

    pyamg builds the hierarchy; the cycle is ours because pyamg's measures two residuals more per call. On the finest
    level the matrix is used without blocks, where a Gauss–Seidel sweep costs half as much.
    """
    import pyamg
    from pyamg.relaxation.relaxation import gauss_seidel

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # pyamg warns of its own conversions between sparse formats
        options: dict[str, Any] = {
            "strength": ("symmetric", {"theta": 0.0}),
            "smooth": ("jacobi", {"omega": 4 / 3}),
            "improve_candidates": None,
            "max_coarse": 500,
        }
        state = np.random.get_state()  # noqa: NPY002 (pyamg starts its power iterations from the global generator)
        np.random.seed(0)  # noqa: NPY002
        levels = pyamg.smoothed_aggregation_solver(matrix, B=rigid_motions(points), **options).levels
        np.random.set_state(state)  # noqa: NPY002
    levels[0].A = matrix.tocsr()
    coarsest = np.linalg.pinv(levels[-1].A.toarray(), hermitian=True)

    def cycle(load: np.ndarray, depth: int = 0) -> np.ndarray:
        if depth == len(levels) - 1:
            return coarsest @ load
        level = levels[depth]
        solution = np.zeros_like(load)
        gauss_seidel(level.A, solution, load, sweep="forward")
        solution += level.P @ cycle(level.R @ (load - level.A @ solution), depth + 1)
        gauss_seidel(level.A, solution, load, sweep="backward")
        return solution

    return preconditioner_of(matrix, cycle)


class Equilibrium:
    """The elastic equilibrium on one mesh, for any number of loads.

    Args:
        spring: stiffness of the clamp at each node in N/mm, ``[N]``.
        near: of the same cells at nearly the same points, whose multigrid hierarchy serves here too.
        tolerance: relative residual of the solutions; :data:`TOLERANCE` if None.
        stiffness: of each cell relative to the material, ``[T]``; 1 if None.
    """

    def __init__(
        self,
        elements: P1,
        material: Material,
        spring: np.ndarray,
        near: Equilibrium | None = None,
        tolerance: float | None = None,
        stiffness: np.ndarray | None = None,
    ) -> None:
        self._tolerance = TOLERANCE if tolerance is None else tolerance
        self.matrix = elements.elastic(*material.lame, spring, stiffness)
        self._preconditioner = near._preconditioner if near else multigrid(self.matrix, elements.mesh.points)

    def solve(self, load: np.ndarray, guess: np.ndarray | None = None) -> tuple[np.ndarray, int]:
        """Displacement in mm ``[N,3]`` under forces in N ``[N,3]``; CG iterations, from ``guess [N,3]`` on.

        Raises:
            SolveError: the solve did not converge.
        """
        what = "the elastic equilibrium"
        start = None if guess is None else guess.reshape(-1)
        solution, count = solve_spd(self.matrix, load.reshape(-1), self._preconditioner, self._tolerance, start, what)
        return solution.reshape(-1, 3), count


def thermal_load(elements: P1, material: Material, temperature_rise: np.ndarray) -> np.ndarray:
    """Forces in N ``[N,3]`` of the temperature rise above the stress-free one, ``[N]`` in K."""
    return elements.divergence_load(material.thermal_modulus * temperature_rise[elements.cells].mean(axis=1))


def stress(elements: ShapeFunctions[Array], material: Material, displacement: Array, temperature_rise: Array) -> Array:
    """σ in MPa in each cell, ``[T,3,3]``; arrays or tensors. The temperature is averaged over the cell, as ε is
    constant in it.

    Args:
        displacement: mm, ``[N,3]``.
        temperature_rise: above the stress-free temperature in K, ``[N]``.
    """
    rise: Any = temperature_rise[elements.cells].mean(1)
    return hooke(elements.strain(displacement), material, rise)


def hooke(strain: Array, material: Material, temperature_rise: Array) -> Array:
    """σ in MPa of cells under ``strain [T,3,3]`` and a ``temperature_rise [T]`` in K; arrays or tensors."""
    lam, mu = material.lame
    pressure = lam * trace(strain) - material.thermal_modulus * temperature_rise
    return 2 * mu * strain + pressure[:, None, None] * namespace(strain).eye(3, dtype=strain.dtype)


def von_mises(stress: Array) -> Array:
    """√(3/2 s:s) with s the deviator of the symmetric ``stress [...,3,3]``; arrays or tensors.

    Where there is no stress it is 1e-10, as the root has no derivative at 0.
    """
    xx, yy, zz = (stress[..., i, i] for i in range(3))
    normal = ((xx - yy) ** 2 + (yy - zz) ** 2 + (zz - xx) ** 2) / 2
    shear = stress[..., 0, 1] ** 2 + stress[..., 1, 2] ** 2 + stress[..., 2, 0] ** 2
    return (normal + 3 * shear).clip(1e-20) ** 0.5


def trace(tensor: Array) -> Array:
    """Of ``[...,3,3]``."""
    return tensor[..., 0, 0] + tensor[..., 1, 1] + tensor[..., 2, 2]

"""The same physics through scikit-fem's weak forms, in P1 or P2: slower and plain, an oracle for tests and benchmarks.

The solver does not use it; scikit-fem comes with the extra ``oracle``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp

from genmf_mi.core.errors import SetupError
from genmf_mi.stress.fem.elasticity import multigrid, soft_clamp, von_mises
from genmf_mi.stress.fem.linear import jacobi, solve_spd
from genmf_mi.stress.fem.materials import Material
from genmf_mi.stress.fem.protocol import Protocol
from genmf_mi.stress.fem.tet_mesh import TetMesh


@dataclass(frozen=True)
class ReferenceSolution:
    """A solution in scikit-fem's terms.

    heat_basis, elastic_basis: of temperature and displacement, whose coefficients are in °C and mm. stress: at the
    quadrature points, ``[3,3,T,Q]`` in MPa; weights: mm³, ``[T,Q]``; points: mm, ``[3,T,Q]``.
    """

    heat_basis: Any
    elastic_basis: Any
    temperature: np.ndarray
    displacement: np.ndarray
    stress: np.ndarray
    weights: np.ndarray
    points: np.ndarray

    @property
    def von_mises(self) -> np.ndarray:
        """``[T,Q]``."""
        return von_mises(self.stress.transpose(2, 3, 0, 1))

    @property
    def mean(self) -> float:
        """Mean von Mises of the body in MPa."""
        return float((self.von_mises * self.weights).sum() / self.weights.sum())


class Forms:
    """Bases and matrices on one mesh.

    Args:
        order: 1 or 2, for temperature and displacement alike.

    Raises:
        SetupError: scikit-fem is not installed.
    """

    def __init__(self, mesh: TetMesh, material: Material, order: int = 1) -> None:
        skfem = _scikit_fem()
        ddot, dot, grad, sym_grad, trace = (
            getattr(skfem.helpers, name) for name in ("ddot", "dot", "grad", "sym_grad", "trace")
        )

        lam, mu = material.lame
        self.material, self.order = material, order
        self.mesh = skfem.MeshTet(np.ascontiguousarray(mesh.points.T), np.ascontiguousarray(mesh.cells.T))
        scalar = {1: skfem.ElementTetP1, 2: skfem.ElementTetP2}[order]()
        self.heat = skfem.Basis(self.mesh, scalar, intorder=2 * order)
        self.elastic = skfem.Basis(self.mesh, skfem.ElementVector(scalar), intorder=2 * order)
        self.surface = skfem.FacetBasis(self.mesh, scalar, intorder=2 * order)

        self.stiffness = skfem.BilinearForm(lambda u, v, w: dot(grad(u), grad(v))).assemble(self.heat)
        self.mass = skfem.BilinearForm(lambda u, v, w: u * v).assemble(self.heat)
        self.boundary_mass = skfem.BilinearForm(lambda u, v, w: u * v).assemble(self.surface)
        self.boundary_load = skfem.LinearForm(lambda v, w: v).assemble(self.surface)
        self.elasticity = skfem.BilinearForm(
            lambda u, v, w: lam * trace(sym_grad(u)) * trace(sym_grad(v)) + 2 * mu * ddot(sym_grad(u), sym_grad(v))
        ).assemble(self.elastic)
        self._dot, self._trace, self._sym_grad = dot, trace, sym_grad
        self._linear, self._bilinear = skfem.LinearForm, skfem.BilinearForm

    def thermal_load(self, temperature_rise: np.ndarray) -> np.ndarray:
        """∫ β ΔT div v; with P1 the temperature is averaged over the cell, as the strain is constant in it."""
        beta, trace, sym_grad = self.material.thermal_modulus, self._trace, self._sym_grad
        return self._linear(lambda v, w: beta * w["temperature_rise"] * trace(sym_grad(v))).assemble(
            self.elastic, temperature_rise=self._at_quadrature_points(temperature_rise)
        )

    def clamp(self, fraction: float) -> Any:
        """The soft clamp as a sparse matrix: with P1 as springs at the nodes, as in the solver; with P2 integrated,
        κ ∫ w u·v."""
        dot, height, modulus = self._dot, self.mesh.p[2], self.material.youngs_modulus_mpa
        if self.order == 1:
            volume = np.asarray(self.mass.sum(axis=1)).ravel()
            spring = np.zeros(self.elastic.N)
            spring[self.elastic.nodal_dofs] = soft_clamp(height, volume, modulus, fraction)
            return sp.diags(spring)
        points = np.asarray(self.elastic.global_coordinates())[2]
        # The nodes are passed along, as the height of the body is that of its nodes.
        every = np.concatenate([points.reshape(-1), height])
        stiffness = soft_clamp(every, np.ones_like(every), modulus, fraction)[: points.size].reshape(points.shape)
        return self._bilinear(lambda u, v, w: w["stiffness"] * dot(u, v)).assemble(self.elastic, stiffness=stiffness)

    def stress(self, displacement: np.ndarray, temperature_rise: np.ndarray) -> np.ndarray:
        """σ at the quadrature points, ``[3,3,T,Q]`` in MPa."""
        lam, mu = self.material.lame
        field: Any = self.elastic.interpolate(displacement)
        strain = self._sym_grad(field)
        thermal = self.material.thermal_modulus * self._at_quadrature_points(temperature_rise)
        return 2 * mu * strain + np.eye(3)[:, :, None, None] * (lam * self._trace(strain) - thermal)

    def _at_quadrature_points(self, temperature_rise: np.ndarray) -> np.ndarray:
        value = np.asarray(self.heat.interpolate(temperature_rise))
        if self.order == 1:
            integral = (value * self.heat.dx).sum(axis=1, keepdims=True)
            value = np.broadcast_to(integral, value.shape) / self.heat.dx.sum(axis=1, keepdims=True)
        return value


def solve(
    mesh: TetMesh, material: Material, protocol: Protocol, order: int = 1, tolerance: float = 1e-9
) -> ReferenceSolution:
    """What :func:`genmf_mi.stress.fem.problem.solve` computes.

    Raises:
        SetupError: scikit-fem is not installed. SolveError: a solve did not converge.
    """
    forms = Forms(mesh, material, order)
    start, dt = material.stress_free_celsius, protocol.step_s
    capacity = forms.mass * (material.volumetric_heat_j_mm3k / dt)
    system = (
        capacity
        + forms.stiffness * material.conductivity_w_mmk
        + forms.boundary_mass * protocol.heat_transfer_coefficient_w_mm2k
    )
    preconditioner = jacobi(system)
    temperature_rise = np.zeros(forms.heat.N)
    for step in range(1, protocol.steps + 1):
        ambient = protocol.ambient(step * dt, start) - start
        load = capacity @ temperature_rise + forms.boundary_load * (protocol.heat_transfer_coefficient_w_mm2k * ambient)
        temperature_rise, _ = solve_spd(
            system, load, preconditioner, tolerance, guess=temperature_rise, what="the heat equation"
        )

    matrix = (forms.elasticity + forms.clamp(protocol.clamp_fraction)).tocsr()
    load = forms.thermal_load(temperature_rise)
    # Components of a degree of freedom lie side by side, so 3×3 blocks and rigid motions carry over to either order.
    preconditioner = multigrid(matrix.tobsr((3, 3)), forms.elastic.doflocs[:, ::3].T)
    displacement, _ = solve_spd(matrix, load, preconditioner, tolerance, what="the elastic equilibrium")
    return ReferenceSolution(
        forms.heat,
        forms.elastic,
        start + temperature_rise,
        displacement,
        forms.stress(displacement, temperature_rise),
        forms.elastic.dx,
        np.asarray(forms.elastic.global_coordinates()),
    )


def _scikit_fem() -> Any:
    try:
        import skfem
        import skfem.helpers
    except ImportError as error:
        raise SetupError(
            "the reference solution needs scikit-fem, which is not installed: pip install 'genmf-mi[oracle]'."
        ) from error
    return skfem

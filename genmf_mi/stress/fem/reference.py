"""The same physics through scikit-fem's weak forms, in P1 or P2: slower, plain, and the oracle of the tests."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from genmf_mi.stress.fem.elasticity import multigrid, soft_clamp, von_mises
from genmf_mi.stress.fem.linear import solve_spd
from genmf_mi.stress.fem.materials import Material
from genmf_mi.stress.fem.protocol import Protocol
from genmf_mi.stress.fem.tetrahedra import TetMesh


@dataclass(frozen=True)
class Reference:
    """A solution in scikit-fem's terms.

    heat_basis, elastic_basis: of temperature and displacement, whose coefficients are in °C and mm. stress: at the
    quadrature points, ``[3,3,T,Q]`` in MPa; weights: mm³, ``[T,Q]``; points: mm, ``[3,T,Q]``.
    """

    heat_basis: object
    elastic_basis: object
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
        return float((self.von_mises * self.weights).sum() / self.weights.sum())


class Forms:
    """Bases and matrices on one mesh. ``order`` 1 or 2, for temperature and displacement alike."""

    def __init__(self, mesh: TetMesh, material: Material, order: int = 1) -> None:
        import skfem
        from skfem.helpers import ddot, dot, grad, sym_grad, trace

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
        self._trace, self._sym_grad = trace, sym_grad
        self._linear, self._bilinear = skfem.LinearForm, skfem.BilinearForm

    def thermal_load(self, excess: np.ndarray) -> np.ndarray:
        """∫ β ΔT div v; with P1 the temperature is averaged over the cell, as the strain is constant in it."""
        beta, trace, sym_grad = self.material.thermal_modulus, self._trace, self._sym_grad
        return self._linear(lambda v, w: beta * w["excess"] * trace(sym_grad(v))).assemble(
            self.elastic, excess=self._at_points(excess)
        )

    def clamp(self, fraction: float) -> sp.spmatrix:
        """The soft clamp: with P1 as springs at the nodes, as the solver has it; with P2 integrated, κ ∫ w u·v."""
        from skfem.helpers import dot

        height, modulus = self.mesh.p[2], self.material.youngs_modulus_mpa
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

    def _at_points(self, excess: np.ndarray) -> np.ndarray:
        value = np.asarray(self.heat.interpolate(excess))
        if self.order == 1:
            value = np.broadcast_to((value * self.heat.dx).sum(axis=1, keepdims=True), value.shape) / self.heat.dx.sum(
                axis=1, keepdims=True
            )
        return value

    def stress(self, moved: np.ndarray, excess: np.ndarray) -> np.ndarray:
        lam, mu = self.material.lame
        strain = self._sym_grad(self.elastic.interpolate(moved))
        pressure = lam * self._trace(strain) - self.material.thermal_modulus * self._at_points(excess)
        return 2 * mu * strain + np.eye(3)[:, :, None, None] * pressure


def solve(mesh: TetMesh, material: Material, protocol: Protocol, order: int = 1, tolerance: float = 1e-9) -> Reference:
    """What :func:`genmf_mi.stress.fem.simulation.solve` computes. Raises :class:`SolveError`."""
    forms = Forms(mesh, material, order)
    start, dt = material.stress_free_celsius, protocol.step_s
    capacity = forms.mass * (material.volumetric_heat_j_mm3k / dt)
    system = (
        capacity
        + forms.stiffness * material.conductivity_w_mmk
        + forms.boundary_mass * protocol.heat_transfer_coefficient_w_mm2k
    )
    inverse = 1.0 / system.diagonal()
    jacobi = sp.linalg.LinearOperator(system.shape, lambda x: inverse * x)
    excess = np.zeros(forms.heat.N)
    for step in range(1, protocol.steps + 1):
        ambient = protocol.ambient(step * dt, start) - start
        load = capacity @ excess + forms.boundary_load * (protocol.heat_transfer_coefficient_w_mm2k * ambient)
        excess, _ = solve_spd(system, load, jacobi, tolerance, guess=excess, what="the heat equation")

    matrix = (forms.elasticity + forms.clamp(protocol.clamp_fraction)).tocsr()
    load = forms.thermal_load(excess)
    # Components of a degree of freedom lie side by side, so 3×3 blocks and rigid motions carry over to either order.
    preconditioner = multigrid(matrix.tobsr((3, 3)), forms.elastic.doflocs[:, ::3].T)
    moved, _ = solve_spd(matrix, load, preconditioner, tolerance, what="the elastic equilibrium")
    return Reference(
        forms.heat,
        forms.elastic,
        start + excess,
        moved,
        forms.stress(moved, excess),
        forms.elastic.dx,
        np.asarray(forms.elastic.global_coordinates()),
    )

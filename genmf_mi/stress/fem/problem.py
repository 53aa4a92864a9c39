"""The boundary-value problem on one mesh: heat, then elasticity, then von Mises."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from genmf_mi.core.progress import Progress
from genmf_mi.core.timer import Timer
from genmf_mi.stress.fem import elasticity, heat
from genmf_mi.stress.fem.assembly import P1
from genmf_mi.stress.fem.materials import Material
from genmf_mi.stress.fem.protocol import Protocol
from genmf_mi.stress.fem.stages import DONE, PartialProgress, stage
from genmf_mi.stress.fem.tet_mesh import TetMesh


@dataclass(frozen=True)
class Field:
    """The solution on one mesh, in millimetres, °C and MPa; z is up and the base at z = 0.

    temperature: ``[N]``. displacement: ``[N,3]``. stress: ``[T,3,3]``, constant in each cell.
    von_mises: ``[T]``. von_mises_nodes: ``[N]``, the volume-weighted average of the cells at the node (of the value,
    not of the tensor, which would hide a bending stress that changes sign).
    iterations: of conjugate gradients for the elastic equilibrium.
    """

    elements: P1
    temperature: np.ndarray
    displacement: np.ndarray
    stress: np.ndarray
    von_mises: np.ndarray
    von_mises_nodes: np.ndarray
    iterations: int

    @property
    def mesh(self) -> TetMesh:
        return self.elements.mesh


class Problem:
    """One body with its material and protocol, and all that the adjoint needs (:mod:`genmf_mi.stress.fem.sensitivity`).

    ambient: T_amb − T₀ at each time step, ``[K]``. Once solved, there are ``cooling`` and ``equilibrium``, the two
    linear systems, ``temperature_rise [K+1,N]``, T − T₀ after each time step (negative, as the body cools), and
    ``displacement [N,3]``.

    Args:
        mesh: in millimetres with z up.
        near: a solved problem of the same cells at nearly the same points, whose solution the solves start from.
        tolerance: relative residual of the equilibrium, see :class:`genmf_mi.stress.fem.elasticity.Equilibrium`.
    """

    def __init__(
        self,
        mesh: TetMesh,
        material: Material,
        protocol: Protocol,
        near: Problem | None = None,
        tolerance: float | None = None,
    ) -> None:
        self.elements, self._tolerance = near.elements.at(mesh.points) if near else P1(mesh), tolerance
        self.material, self.protocol, self._near = material, protocol, near
        start = material.stress_free_celsius
        times = protocol.step_s * np.arange(1, protocol.steps + 1)
        self.ambient = np.array([protocol.ambient(time, start) - start for time in times])

    def solve(self, timer: Timer | None = None, progress: Progress | None = None) -> Field:
        """The field; the laps of ``timer`` are ``heat``, ``elasticity`` and ``stress``.

        Raises:
            SolveError: a solve did not converge.
        """
        timer, progress = timer or Timer(), progress or Progress()
        elements, material, protocol = self.elements, self.material, self.protocol
        with stage("heat", timer, progress):
            self.cooling = heat.Cooling(elements, material, protocol.heat_transfer_coefficient_w_mm2k, protocol.step_s)
            steps = PartialProgress(progress, DONE["tetrahedra"], DONE["heat"])
            guess = self._near.temperature_rise if self._near else None
            self.temperature_rise = self.cooling.run(self.ambient, steps, guess)
        final = self.temperature_rise[-1]
        with stage("elasticity", timer, progress):
            spring = elasticity.soft_clamp(
                elements.mesh.points[:, 2],
                elements.nodal_volume(),
                material.youngs_modulus_mpa,
                protocol.clamp_fraction,
            )
            near = self._near
            self.equilibrium = elasticity.Equilibrium(
                elements, material, spring, near.equilibrium if near else None, self._tolerance
            )
            load = elasticity.thermal_load(elements, material, final)
            displacement, iterations = self.equilibrium.solve(load, near.displacement if near else None)
            self.displacement = displacement
        with stage("stress", timer, progress):
            stress = elasticity.stress(elements, material, displacement, final)
            von_mises = elasticity.von_mises(stress)
            at_nodes = elements.to_nodes(von_mises)
        temperature = material.stress_free_celsius + final
        return Field(elements, temperature, displacement, stress, von_mises, at_nodes, iterations)


def solve(mesh: TetMesh, material: Material, protocol: Protocol) -> Field:
    """The field on ``mesh``, given in millimetres with z up.

    Raises:
        SolveError: a solve did not converge.
    """
    return Problem(mesh, material, protocol).solve()

"""Transient heat conduction with a Robin boundary, backward Euler in time.

ρ c_p ∂T/∂t = ∇·(k ∇T)  inside,    −k ∂T/∂n = h (T − T_amb(t))  on the surface,    T(0) = T₀
"""

from __future__ import annotations

import numpy as np

from genmf_mi.core.progress import Progress
from genmf_mi.stress.fem.assembly import P1
from genmf_mi.stress.fem.linear import jacobi, solve_spd
from genmf_mi.stress.fem.materials import Material

TOLERANCE = 1e-7
"""Relative residual of a time step."""


class Cooling:
    """The heat equation on one mesh, for T − T₀, so that the tolerance is relative to the change of temperature.

    A time step solves A T_k = C T_{k−1} + b T_amb,k with A = C + K + B: capacity, conduction, and convection at the
    surface.

    Args:
        heat_transfer_coefficient: h in W/(mm² K).
        step_s: length of a time step.
    """

    def __init__(self, elements: P1, material: Material, heat_transfer_coefficient: float, step_s: float) -> None:
        self.capacity = elements.mass() * (material.volumetric_heat_j_mm3k / step_s)
        convection = elements.boundary_mass() * heat_transfer_coefficient
        self.system = (self.capacity + elements.stiffness() * material.conductivity_w_mmk + convection).tocsr()
        self.inflow = elements.boundary_load() * heat_transfer_coefficient
        # One step couples a node to little more than its neighbours, so a diagonal preconditioner is enough.
        self._preconditioner = jacobi(self.system)

    def run(self, ambient: np.ndarray, progress: Progress | None = None, guess: np.ndarray | None = None) -> np.ndarray:
        """T_k − T₀ after each time step ``[K+1,N]``, the first of them zero.

        Args:
            ambient: T_amb − T₀ at each step, ``[K]``.
            guess: of the result; every step starts from the one before if None.

        Raises:
            SolveError: a step did not converge.
        """
        progress = progress or Progress()
        temperature_rise = np.zeros((len(ambient) + 1, len(self.inflow)))
        for step, outside in enumerate(ambient, start=1):
            previous = temperature_rise[step - 1]
            start = previous if guess is None else guess[step]
            temperature_rise[step] = self._solve(self.capacity @ previous + self.inflow * outside, guess=start)
            progress.advance(step, len(ambient))
        return temperature_rise

    def adjoint(self, gradient: np.ndarray, steps: int) -> np.ndarray:
        """Multipliers μ_k of each step ``[K,N]``, for the ``gradient [N]`` of a scalar with respect to the last T: if
        a step's residual A T_k − C T_{k−1} − b T_amb,k changes by δr_k, the scalar changes by −Σ μ_k·δr_k.

        Raises:
            SolveError: a step did not converge.
        """
        multiplier = np.zeros((steps, len(gradient)))
        load = gradient
        for step in reversed(range(steps)):
            multiplier[step] = self._solve(load, guess=None)
            load = self.capacity @ multiplier[step]
        return multiplier

    def _solve(self, load: np.ndarray, guess: np.ndarray | None) -> np.ndarray:
        return solve_spd(self.system, load, self._preconditioner, TOLERANCE, guess=guess, what="the heat equation")[0]

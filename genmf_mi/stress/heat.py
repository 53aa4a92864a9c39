"""Transient heat conduction with a Robin boundary, backward Euler in time.

ρ c_p ∂T/∂t = ∇·(k ∇T)  inside,    −k ∂T/∂n = h (T − T_amb(t))  on the surface,    T(0) = T₀
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.sparse as sp

from genmf_mi.stress.assembly import P1
from genmf_mi.stress.linear import solve_spd
from genmf_mi.stress.materials import Material

TOLERANCE = 1e-7


def transient(
    elements: P1,
    material: Material,
    film_w_mm2k: float,
    ambient: Callable[[float], float],
    start_celsius: float,
    step_s: float,
    steps: int,
    progress: Callable[[int, int], None] | None = None,
) -> np.ndarray:
    """Temperature in °C at the nodes ``[N]`` after ``steps`` steps of ``step_s`` seconds.

    Raises:
        SolveError: a step did not converge.
    """
    capacity = elements.mass() * (material.volumetric_heat_j_mm3k / step_s)
    loss = elements.boundary_mass() * film_w_mm2k
    system = (capacity + elements.stiffness() * material.conductivity_w_mmk + loss).tocsr()
    inflow = elements.boundary_load() * film_w_mm2k
    # One step couples a node to little more than its neighbours, so a diagonal preconditioner is enough.
    inverse = 1.0 / system.diagonal()
    preconditioner = sp.linalg.LinearOperator(system.shape, lambda x: inverse * x)
    # Solved for T − T₀, whose scale is that of the change and not that of the thermometer.
    excess = np.zeros(elements.nodes)
    for step in range(1, steps + 1):
        load = capacity @ excess + inflow * (ambient(step * step_s) - start_celsius)
        excess, _ = solve_spd(system, load, preconditioner, TOLERANCE, guess=excess, what="the heat equation")
        if progress is not None:
            progress(step, steps)
    return start_celsius + excess

"""A hollow sphere, warm air inside and cold air outside: temperature and stress against the closed form.

Timoshenko & Goodier, Theory of Elasticity, article on the hollow sphere. Radii 18 and 45 mm; the meshes come from
isosurface stuffing. The stress is compared by its deviator, which von Mises is the length of.
"""

from __future__ import annotations

import numpy as np

from benchmarks import record
from benchmarks.inputs import Inputs
from genmf_mi.stress.fem import elasticity
from genmf_mi.stress.fem.assembly import P1
from genmf_mi.stress.fem.linear import jacobi, solve_spd
from genmf_mi.stress.fem.materials import material
from genmf_mi.stress.fem.tetrahedra import isosurface_stuffing

EDGES_MM = (12.0, 10.0, 8.0, 7.0, 6.0, 5.0, 4.2, 3.6)
INNER_MM, OUTER_MM = 18.0, 45.0
HEAT_TRANSFER = 5e-6
"""W/mm²K, on either surface."""
WARM, COLD = 40.0, -35.0
"""Of the air inside and outside, K above the stress-free temperature."""
PLA = material("pla")


def main(inputs: Inputs) -> None:
    """Solve on a sequence of meshes; the orders are those from the coarsest to the finest.

    Args:
        inputs: What all benchmarks have in common; this one reads none of them.
    """
    rows = []
    for edge in EDGES_MM:
        rows.append([edge, *(round(error, 8) for error in errors(edge))])
        print(rows[-1], flush=True)
    (coarse, *first), (fine, *last) = rows[0], rows[-1]
    order = [round(float(np.log(a / b) / np.log(coarse / fine)), 2) for a, b in zip(first, last, strict=True)]
    columns = ["edge_mm", "temperature_relative_l2", "deviatoric_stress_relative_l2"]
    record.write_verification("hollow_sphere", {"columns": columns, "rows": rows, "order": order})


def errors(edge_mm: float) -> tuple[float, float]:
    """Relative L2 errors of the temperature and of the deviator of the stress."""
    ticks = np.linspace(-1, 1, 97)
    r = np.linalg.norm(np.meshgrid(ticks, ticks, ticks, indexing="ij"), axis=0)
    mesh = isosurface_stuffing(np.maximum(r - OUTER_MM / 50, INNER_MM / 50 - r), edge_mm / 50)
    mesh = mesh.with_points(50 * mesh.points)

    whole, cavity, skin = P1(mesh), P1(mesh), P1(mesh)
    radius = np.linalg.norm(mesh.points[whole.boundary].mean(axis=1), axis=1)
    cavity.boundary, skin.boundary = whole.boundary[radius < 30], whole.boundary[radius > 30]
    system = whole.stiffness() * PLA.conductivity_w_mmk
    system = system + (cavity.boundary_mass() + skin.boundary_mass()) * HEAT_TRANSFER
    load = HEAT_TRANSFER * (WARM * cavity.boundary_load() + COLD * skin.boundary_load())
    temperature_rise, _ = solve_spd(system.tocsr(), load, jacobi(system), 1e-10)

    constant, slope = temperature()
    exact = constant + slope / np.linalg.norm(mesh.points, axis=1)
    mass, difference = whole.mass(), temperature_rise - exact
    temperature_error = np.sqrt((difference @ (mass @ difference)) / (exact @ (mass @ exact)))

    # Springs too soft to matter take away the rigid motions
    spring = 1e-7 * PLA.youngs_modulus_mpa / OUTER_MM**2 * whole.nodal_volume()
    thermal = elasticity.thermal_load(whole, PLA, temperature_rise)
    displacement, _ = elasticity.Equilibrium(whole, PLA, spring).solve(thermal)
    stress = elasticity.stress(whole, PLA, displacement, temperature_rise)
    expected = exact_stress(mesh.points[mesh.cells].mean(axis=1))

    def square(tensor: np.ndarray) -> float:
        return float((whole.volumes * elasticity.von_mises(tensor) ** 2).sum())

    return float(temperature_error), float(np.sqrt(square(stress - expected) / square(expected)))


def temperature() -> tuple[float, float]:
    """A and B of T = A + B / r, from k B / a² = h (T_warm − T(a)) and k B / b² = h (T(b) − T_cold)."""
    k, h, a, b = PLA.conductivity_w_mmk, HEAT_TRANSFER, INNER_MM, OUTER_MM
    system = np.array([[h, h / a + k / a**2], [h, h / b - k / b**2]])
    constant, slope = np.linalg.solve(system, [h * WARM, h * COLD])
    return float(constant), float(slope)


def exact_stress(points: np.ndarray) -> np.ndarray:
    """The stress tensor ``[N,3,3]`` in MPa at ``points [N,3]``."""
    constant, slope = temperature()
    a, b, r = INNER_MM, OUTER_MM, np.linalg.norm(points, axis=1)

    def heat(radius: np.ndarray | float) -> np.ndarray | float:
        """∫ T r² dr from a."""
        return constant * (radius**3 - a**3) / 3 + slope * (radius**2 - a**2) / 2

    factor = 2 * PLA.expansion_per_k * PLA.youngs_modulus_mpa / (1 - PLA.poisson_ratio)
    share = heat(b) / (b**3 - a**3)
    radial = factor * (share * (r**3 - a**3) - heat(r)) / r**3
    hoop = factor * (share * (2 * r**3 + a**3) / (2 * r**3) + heat(r) / (2 * r**3) - (constant + slope / r) / 2)
    n = points / r[:, None]
    along = n[:, :, None] * n[:, None, :]
    return radial[:, None, None] * along + hoop[:, None, None] * (np.eye(3) - along)

"""Heat and elasticity against closed forms and manufactured solutions."""

from __future__ import annotations

import numpy as np
import pytest

from genmf_mi.stress.fem import elasticity, heat
from genmf_mi.stress.fem.assembly import P1
from genmf_mi.stress.fem.linear import jacobi, solve_spd
from genmf_mi.stress.fem.materials import material
from genmf_mi.stress.fem.tet_mesh import TetMesh
from genmf_mi.stress.fem.tetrahedra import isosurface_stuffing

PLA = material("pla")


def box(*ticks: np.ndarray) -> TetMesh:
    """Tetrahedra of a block with the given grid lines."""
    import skfem

    mesh = skfem.MeshTet.init_tensor(*ticks)
    return TetMesh(np.ascontiguousarray(mesh.p.T), mesh.t.T.astype(np.int64)).oriented()


def cube(n: int) -> TetMesh:
    return box(*[np.linspace(0.0, 1.0, n + 1)] * 3)


def on_boundary(mesh: TetMesh) -> np.ndarray:
    flag = np.zeros(len(mesh.points), dtype=bool)
    flag[mesh.boundary()] = True
    return flag


def rate(errors: list[float], sizes: list[float]) -> float:
    """Observed order from the coarsest to the finest mesh."""
    return float(np.log(errors[0] / errors[-1]) / np.log(sizes[0] / sizes[-1]))


def test_free_expansion_is_free_of_stress() -> None:
    """u = α ΔT x balances a uniform ΔT on any mesh, and leaves σ = 0 to round-off."""
    ticks = np.linspace(-1, 1, 25)
    x, y, z = np.meshgrid(ticks, ticks, ticks, indexing="ij")
    mesh = isosurface_stuffing(np.sqrt(x**2 + (1.3 * y) ** 2 + z**2) - 0.8, 0.3)
    elements, temperature_rise = P1(mesh), np.full(len(mesh.points), -35.0)
    displacement = PLA.expansion_per_k * -35.0 * mesh.points
    load = elements.divergence_load(PLA.thermal_modulus * temperature_rise[mesh.cells].mean(axis=1))
    residual = elements.elastic(*PLA.lame) @ displacement.reshape(-1) - load.reshape(-1)
    assert abs(residual).max() < 1e-13 * abs(load).max() * 100
    stress = elasticity.stress(elements, PLA, displacement, temperature_rise)
    assert abs(stress).max() < 1e-12 * PLA.thermal_modulus * 35


def balanced(elements: P1, temperature_rise: np.ndarray, spring: np.ndarray) -> np.ndarray:
    """Displacement under a temperature rise."""
    load = elasticity.thermal_load(elements, PLA, temperature_rise)
    return elasticity.Equilibrium(elements, PLA, spring).solve(load)[0]


def test_clamped_block() -> None:
    """A block held on all sides answers a uniform ΔT with σ = −E α ΔT / (1 − 2ν)."""
    mesh = cube(4)
    elements, temperature_rise = P1(mesh), np.full(len(mesh.points), -35.0)
    hold = np.where(on_boundary(mesh), 1e12, 0.0)
    displacement = balanced(elements, temperature_rise, hold)
    expected = PLA.youngs_modulus_mpa * PLA.expansion_per_k * 35.0 / (1 - 2 * PLA.poisson_ratio)
    stress = elasticity.stress(elements, PLA, displacement, temperature_rise)
    assert np.allclose(stress, expected * np.eye(3), atol=1e-6 * expected)


def hollow_sphere(edge: float) -> tuple[float, float]:
    """Relative L2 errors of temperature and of the deviator of stress, which von Mises is the length of.

    Radii 18 and 45 mm, warm air inside and cold air outside.
    """
    inner, outer, coefficient = 18.0, 45.0, 5e-6
    ticks = np.linspace(-1, 1, 97)
    r = np.sqrt(sum(c**2 for c in np.meshgrid(ticks, ticks, ticks, indexing="ij")))
    mesh = isosurface_stuffing(np.maximum(r - outer / 50, inner / 50 - r), edge / 50)
    mesh = mesh.with_points(50 * mesh.points)

    whole, cavity, skin = P1(mesh), P1(mesh), P1(mesh)
    radius = np.linalg.norm(mesh.points[whole.boundary].mean(axis=1), axis=1)
    cavity.boundary, skin.boundary = whole.boundary[radius < 30], whole.boundary[radius > 30]
    k, warm, cold = PLA.conductivity_w_mmk, 40.0, -35.0
    system = whole.stiffness() * k + (cavity.boundary_mass() + skin.boundary_mass()) * coefficient
    load = coefficient * (warm * cavity.boundary_load() + cold * skin.boundary_load())
    temperature_rise, _ = solve_spd(system.tocsr(), load, jacobi(system), 1e-10)

    # T = A + B / r with  k B / a² = h (warm − T(a))  and  k B / b² = h (T(b) − cold).
    a, b = inner, outer
    system = np.array([[coefficient, coefficient / a + k / a**2], [coefficient, coefficient / b - k / b**2]])
    constant, slope = np.linalg.solve(system, [coefficient * warm, coefficient * cold])
    r = np.linalg.norm(mesh.points, axis=1)
    exact = constant + slope / r
    mass = whole.mass()
    error = temperature_rise - exact
    temperature_error = np.sqrt(error @ (mass @ error) / (exact @ (mass @ exact)))

    spring = 1e-7 * PLA.youngs_modulus_mpa / outer**2 * whole.nodal_volume()
    displacement = balanced(whole, temperature_rise, spring)
    stress = elasticity.stress(whole, PLA, displacement, temperature_rise)
    # Timoshenko & Goodier, Theory of Elasticity, article on the hollow sphere.
    centre = mesh.points[mesh.cells].mean(axis=1)
    r = np.linalg.norm(centre, axis=1)
    heat_to = lambda s: constant * (s**3 - a**3) / 3 + slope * (s**2 - a**2) / 2  # noqa: E731  (∫ T r² dr from a)
    factor = 2 * PLA.expansion_per_k * PLA.youngs_modulus_mpa / (1 - PLA.poisson_ratio)
    share = heat_to(b) / (b**3 - a**3)
    radial = factor * (share * (r**3 - a**3) - heat_to(r)) / r**3
    hoop = factor * (share * (2 * r**3 + a**3) / (2 * r**3) + heat_to(r) / (2 * r**3) - (constant + slope / r) / 2)
    n = centre / r[:, None]
    nn = n[:, :, None] * n[:, None, :]
    expected = radial[:, None, None] * nn + hoop[:, None, None] * (np.eye(3) - nn)
    square = lambda s: (whole.volumes * elasticity.von_mises(s) ** 2).sum()  # noqa: E731
    return float(temperature_error), float(np.sqrt(square(stress - expected) / square(expected)))


def test_hollow_sphere_converges() -> None:
    """On stuffed meshes: at least order 1.8 in temperature and 0.9 in stress."""
    sizes = [12.0, 8.0, 5.0]
    errors = np.array([hollow_sphere(size) for size in sizes])
    assert rate(errors[:, 0], sizes) > 1.8
    assert rate(errors[:, 1], sizes) > 0.9
    assert errors[-1, 0] < 5e-3 and errors[-1, 1] < 0.15


def slab_series(x: np.ndarray, time: float, half: float, coefficient: float) -> np.ndarray:
    """(T − T_amb) / (T₀ − T_amb) of a slab of half-thickness ``half``, cooled on both sides (Carslaw & Jaeger 3.11)."""
    from scipy.optimize import brentq

    biot = coefficient * half / PLA.conductivity_w_mmk
    fourier = PLA.conductivity_w_mmk * time / (PLA.volumetric_heat_j_mm3k * half**2)
    total = np.zeros_like(x)
    for n in range(60):
        zeta = brentq(lambda s: s * np.sin(s) - biot * np.cos(s), n * np.pi, n * np.pi + np.pi / 2)
        weight = 4 * np.sin(zeta) / (2 * zeta + np.sin(2 * zeta))
        total += weight * np.exp(-(zeta**2) * fourier) * np.cos(zeta * x / half)
    return total


def test_transient_slab() -> None:
    """Half a slab with convection on one face; backward Euler is of first order in time, and small at 5 s."""
    mesh = box(np.linspace(0.0, 10.0, 41), np.array([0.0, 0.3]), np.array([0.0, 0.3]))
    errors = []
    for step in (20.0, 10.0, 5.0):
        elements = P1(mesh)
        elements.boundary = elements.boundary[mesh.points[elements.boundary][..., 0].min(axis=1) > 10.0 - 1e-9]
        field = 60.0 + heat.Cooling(elements, PLA, 5e-5, step).run(np.full(round(600 / step), -35.0))[-1]
        exact = 25.0 + 35.0 * slab_series(mesh.points[:, 0], 600.0, 10.0, 5e-5)
        errors.append(float(abs(field - exact).max()))
    assert errors[-1] < 0.06
    assert rate(errors, [20.0, 10.0, 5.0]) == pytest.approx(1.0, abs=0.1)


def given_on_boundary(mesh: TetMesh, matrix, load: np.ndarray, exact: np.ndarray, preconditioner) -> np.ndarray:
    """Solve with ``exact [N,C]`` prescribed at the boundary nodes."""
    free = np.repeat(~on_boundary(mesh), exact.shape[1])
    matrix, solution = matrix.tocsr(), exact.reshape(-1).copy()
    right = load.reshape(-1) - matrix[:, ~free] @ solution[~free]
    solution[free], _ = solve_spd(matrix[free][:, free], right[free], preconditioner(matrix[free][:, free]), 1e-11)
    return solution.reshape(exact.shape)


def test_manufactured_heat() -> None:
    """−∇²T = f with T = sin(πx) cos(πy) eᶻ given on the boundary: order 2 in L2."""
    errors, counts = [], [8, 12, 18]
    for n in counts:
        mesh = cube(n)
        elements = P1(mesh)
        x, y, z = mesh.points.T
        exact = (np.sin(np.pi * x) * np.cos(np.pi * y) * np.exp(z))[:, None]
        load = elements.mass() @ ((2 * np.pi**2 - 1) * exact)
        difference = given_on_boundary(mesh, elements.stiffness(), load, exact, jacobi) - exact
        errors.append(float(np.sqrt((difference * (elements.mass() @ difference)).sum())))
    assert rate(errors, [1 / n for n in counts]) > 1.8


def test_manufactured_elasticity() -> None:
    """div σ + f = 0 with u = (sin πx cos πy, sin πy cos πz, sin πz cos πx) given on the boundary.

    Order 2 in displacement, 1 in stress.
    """
    lam, mu = PLA.lame
    errors, counts = [], [8, 12, 18]
    for n in counts:
        mesh = cube(n)
        elements = P1(mesh)
        s, c = np.sin(np.pi * mesh.points), np.cos(np.pi * mesh.points)
        turn = [1, 2, 0]
        exact = s * c[:, turn]
        force = np.pi**2 * ((lam + mu) * s * (c[:, [1, 2, 0]] + c[:, [2, 0, 1]]) + 2 * mu * exact)
        inner = mesh.points[~on_boundary(mesh)]
        multigrid = lambda matrix, points=inner: elasticity.multigrid(matrix.tobsr((3, 3)), points)  # noqa: E731
        displacement = given_on_boundary(mesh, elements.elastic(lam, mu), elements.mass() @ force, exact, multigrid)

        centre = np.pi * mesh.points[mesh.cells].mean(axis=1)
        s, c = np.sin(centre), np.cos(centre)
        gradient = np.zeros((len(centre), 3, 3))
        for i, j in enumerate(turn):
            gradient[:, i, i], gradient[:, i, j] = np.pi * c[:, i] * c[:, j], -np.pi * s[:, i] * s[:, j]
        strain = (gradient + gradient.transpose(0, 2, 1)) / 2
        stress = 2 * mu * strain + lam * np.trace(strain, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        computed = elasticity.stress(elements, PLA, displacement, np.zeros(elements.nodes))
        difference = displacement - exact
        errors.append(
            [
                float(np.sqrt((difference * (elements.mass() @ difference)).sum())),
                float(np.sqrt((elements.volumes * ((computed - stress) ** 2).sum(axis=(1, 2))).sum())),
            ]
        )
    errors, sizes = np.array(errors), [1 / n for n in counts]
    assert rate(errors[:, 0], sizes) > 1.8
    assert rate(errors[:, 1], sizes) > 0.9

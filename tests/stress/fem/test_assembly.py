"""The P1 kernels against scikit-fem on the same mesh."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from genmf_mi.core.errors import SetupError
from genmf_mi.stress.fem import reference
from genmf_mi.stress.fem.assembly import P1
from genmf_mi.stress.fem.materials import material
from genmf_mi.stress.fem.problem import solve
from genmf_mi.stress.fem.protocol import Protocol
from genmf_mi.stress.fem.tet_mesh import TetMesh
from genmf_mi.stress.fem.tetrahedra import isosurface_stuffing


@pytest.fixture(scope="module")
def mesh() -> TetMesh:
    """An ellipsoid of 60 × 40 × 50 mm, off centre, in about 700 nodes."""
    ticks = np.linspace(-1, 1, 33)
    x, y, z = np.meshgrid(ticks, ticks, ticks, indexing="ij")
    phi = (np.sqrt((x / 0.9) ** 2 + (y / 0.6) ** 2 + (z / 0.75) ** 2) - 1) * 0.6
    unit = isosurface_stuffing(phi, 0.22)
    return unit.with_points(unit.points * 33.0 + [5.0, 7.0, 30.0])


@pytest.fixture(scope="module")
def forms(mesh: TetMesh) -> reference.Forms:
    return reference.Forms(mesh, material("pla"))


def relative(a, b) -> float:
    return abs(a - b).max() / abs(b).max()


def test_scalar_matrices(mesh: TetMesh, forms: reference.Forms) -> None:
    elements = P1(mesh)
    assert relative(elements.stiffness(), forms.stiffness) < 1e-12
    assert relative(elements.mass(), forms.mass) < 1e-12
    assert relative(elements.boundary_mass(), forms.boundary_mass) < 1e-12
    assert relative(elements.boundary_load(), forms.boundary_load) < 1e-12


def test_elastic_matrix_and_load(mesh: TetMesh, forms: reference.Forms) -> None:
    elements = P1(mesh)
    pla = material("pla")
    assert relative(elements.elastic(*pla.lame).tocsr(), forms.elasticity) < 1e-12
    temperature_rise = np.sin(mesh.points[:, 0] / 9) - 20
    load = elements.divergence_load(pla.thermal_modulus * temperature_rise[mesh.cells].mean(axis=1))
    assert relative(load.reshape(-1), forms.thermal_load(temperature_rise)) < 1e-12


def test_whole_protocol(mesh: TetMesh) -> None:
    """Temperature, displacement and stress of a whole simulation agree to the tolerance of the solvers."""
    pla, protocol = material("pla"), Protocol()
    ours = solve(mesh, pla, protocol)
    theirs = reference.solve(mesh, pla, protocol)
    assert relative(ours.temperature - 60, theirs.temperature - 60) < 1e-5
    displacement = theirs.displacement[theirs.elastic_basis.nodal_dofs].T
    assert np.linalg.norm(ours.displacement - displacement) / np.linalg.norm(displacement) < 1e-5
    assert np.allclose(ours.stress, theirs.stress.mean(axis=3).transpose(2, 0, 1), atol=1e-5 * abs(ours.stress).max())
    mean = np.average(ours.von_mises, weights=ours.elements.volumes)
    assert mean == pytest.approx(theirs.mean, rel=1e-5)


def test_without_scikit_fem(mesh: TetMesh, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is an extra, so that its absence is one clear sentence; the solver does without."""
    monkeypatch.setitem(sys.modules, "skfem", None)
    with pytest.raises(SetupError, match=r"genmf-mi\[oracle\]"):
        reference.Forms(mesh, material("pla"))
    assert P1(mesh).stiffness().shape == (len(mesh.points),) * 2


def test_quadratic_elements_are_more_accurate_than_linear_ones(mesh: TetMesh) -> None:
    """On one and the same body, halving the linear elements moves the mean towards that of quadratic ones."""
    pla, protocol = material("pla"), Protocol(step_s=300.0, clamp_fraction=0.2)
    quadratic = reference.solve(mesh, pla, protocol, order=2, tolerance=1e-7).mean
    finer = reference.Forms(mesh, pla).mesh.refined()
    halved = oriented(finer.p.T, finer.t.T)
    assert halved.volumes.sum() == pytest.approx(mesh.volumes.sum())
    coarse, fine = (reference.solve(m, pla, protocol, tolerance=1e-7).mean for m in (mesh, halved))
    assert abs(fine - quadratic) < 0.6 * abs(coarse - quadratic)


def oriented(points: np.ndarray, cells: np.ndarray) -> TetMesh:
    return TetMesh(np.ascontiguousarray(points), cells.astype(np.int64)).oriented()

"""What is written once for arrays and tensors: the same values in both, and finite derivatives."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from genmf_mi.stress.fem import elasticity
from genmf_mi.stress.fem.assembly import P1
from genmf_mi.stress.fem.materials import material
from genmf_mi.stress.fem.shape_functions import ShapeFunctions, scatter_sum, triangle_areas
from genmf_mi.stress.fem.tet_mesh import TetMesh
from genmf_mi.stress.fem.tetrahedra import isosurface_stuffing

PLA = material("pla")


@pytest.fixture(scope="module")
def mesh() -> TetMesh:
    ticks = np.linspace(-1, 1, 17)
    x, y, z = np.meshgrid(ticks, ticks, ticks, indexing="ij")
    return isosurface_stuffing(np.sqrt(x**2 + (1.3 * y) ** 2 + z**2) - 0.8, 0.35)


@pytest.fixture(scope="module")
def tensors(mesh: TetMesh) -> ShapeFunctions:
    return ShapeFunctions(torch.from_numpy(mesh.points), torch.from_numpy(mesh.cells))


def test_arrays_and_tensors_agree(mesh: TetMesh, tensors: ShapeFunctions) -> None:
    elements, rng = P1(mesh), np.random.default_rng(0)
    displacement, rise = rng.normal(size=(elements.nodes, 3)), rng.normal(size=elements.nodes)
    pairs = [
        (elements.volumes, tensors.volumes),
        (elements.gradients, tensors.gradients),
        (elements.nodal_volume(), tensors.nodal_volume()),
        (elements.areas, triangle_areas(tensors.points, torch.from_numpy(elements.boundary))),
    ]
    stresses = (
        elasticity.stress(elements, PLA, displacement, rise),
        elasticity.stress(tensors, PLA, torch.from_numpy(displacement), torch.from_numpy(rise)),
    )
    values = tuple(elasticity.von_mises(stress) for stress in stresses)
    pairs += [stresses, values, (elements.to_nodes(values[0]), tensors.to_nodes(values[1]))]
    for ours, theirs in pairs:
        np.testing.assert_allclose(theirs.numpy(), ours, rtol=1e-12, atol=1e-12 * abs(ours).max())


def test_measures(mesh: TetMesh, tensors: ShapeFunctions) -> None:
    """Volumes by another formula, and the volume by the divergence theorem over the boundary."""
    elements = P1(mesh)
    assert elements.volumes == pytest.approx(mesh.volumes)
    assert elements.nodal_volume().sum() == pytest.approx(mesh.volumes.sum())
    a, b, c = (mesh.points[elements.boundary[:, i]] for i in range(3))
    assert np.einsum("ij,ij->", np.cross(b - a, c - a), a) / 6 == pytest.approx(mesh.volumes.sum())
    assert scatter_sum(np.array([2, 0, 2]), np.array([1.0, 2.0, 3.0]), 4).tolist() == [2, 0, 4, 0]


def test_barycentric_coordinates(mesh: TetMesh) -> None:
    """They give back the point, and reproduce a linear field."""
    elements, rng = P1(mesh), np.random.default_rng(0)
    cell = rng.integers(len(mesh.cells), size=50)
    weight = rng.dirichlet(np.ones(4), size=50)
    point = np.einsum("ma,mai->mi", weight, mesh.points[mesh.cells[cell]])
    np.testing.assert_allclose(elements.barycentric(cell, point), weight, atol=1e-12)


def test_von_mises_against_the_deviator() -> None:
    rng = np.random.default_rng(0)
    stress = rng.normal(size=(4, 5, 3, 3))
    stress = stress + stress.swapaxes(-1, -2)
    deviator = stress - np.trace(stress, axis1=-2, axis2=-1)[..., None, None] / 3 * np.eye(3)
    expected = np.sqrt(1.5 * (deviator**2).sum(axis=(-2, -1)))
    np.testing.assert_allclose(elasticity.von_mises(stress), expected, rtol=1e-13)
    uniaxial = np.diag([-7.0, 0, 0])
    assert elasticity.von_mises(uniaxial) == pytest.approx(7.0)
    assert elasticity.von_mises(5 * np.eye(3)) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("pressure", [0.0, 3.0])
def test_the_derivative_is_finite_without_shear_stress(pressure: float) -> None:
    stress = (pressure * torch.eye(3, dtype=torch.float64))[None].requires_grad_()
    elasticity.von_mises(stress).sum().backward()
    assert stress.grad is not None and torch.isfinite(stress.grad).all()

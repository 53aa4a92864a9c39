"""Φ of a mesh as a function of its vertices: its values against exact ones, its derivatives against differences."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import trimesh

from genmf_mi.core.errors import SolidError
from genmf_mi.geometry.mesh_distance import SPARE_CELLS, MeshDistance, closest_weights
from genmf_mi.sdf.distance import signed_distance
from genmf_mi.sdf.redistance import REACH_CELLS
from genmf_mi.stress.model import compute
from genmf_mi.stress.model.network import Architecture, StressNetwork, crop_box

N = 33
CELL = 2 / (N - 1)


def body() -> trimesh.Trimesh:
    """A ball with bumps, longest side about 1.8."""
    mesh = trimesh.creation.icosphere(subdivisions=3)
    x, y, z = mesh.vertices.T
    bumps = 1 + 0.1 * np.sin(6 * x) * np.cos(5 * y + 1) + 0.05 * np.sin(7 * z)
    return trimesh.Trimesh(mesh.vertices * bumps[:, None] * [0.85, 0.6, 0.7], mesh.faces, process=False)


def exact(mesh: trimesh.Trimesh, n: int = N) -> np.ndarray:
    """Unsigned, from libigl, at every sample."""
    import igl

    ticks = np.linspace(-1, 1, n)
    points = np.stack(np.meshgrid(ticks, ticks, ticks, indexing="ij"), axis=-1).reshape(-1, 3)
    squared, _, _ = igl.point_mesh_squared_distance(points, np.asarray(mesh.vertices), mesh.faces.astype(np.int64))
    return np.sqrt(squared).reshape(n, n, n)


def tensor(array: np.ndarray, **options) -> torch.Tensor:
    return torch.tensor(np.asarray(array), dtype=torch.float64, **options)


def test_closest_point_of_triangles() -> None:
    """Against a fine sampling of each triangle, thin and degenerate ones among them."""
    rng = np.random.default_rng(0)
    corners = rng.normal(size=(60, 3, 3))
    corners[40:50, 2] = corners[40:50, 1] + 1e-6 * rng.normal(size=(10, 3))
    corners[50:, 2] = 0.3 * corners[50:, 0] + 0.7 * corners[50:, 1]
    points = 2 * rng.normal(size=(60, 3))
    weights = closest_weights(tensor(points), tensor(corners)).numpy()
    assert (weights >= -1e-9).all() and np.allclose(weights.sum(axis=1), 1)
    found = np.linalg.norm(points - np.einsum("nc,ncd->nd", weights, corners), axis=1)
    grid = np.array([(i, j, 200 - i - j) for i in range(201) for j in range(201 - i)]) / 200
    sampled = np.linalg.norm(points[:, None] - grid @ corners, axis=2).min(axis=1)
    assert (found <= sampled + 1e-9).all()
    assert (sampled - found).max() < 0.02


def test_values_are_those_of_the_data_set() -> None:
    mesh = body()
    phi = MeshDistance(mesh.faces, N)(tensor(mesh.vertices))[0].numpy()
    theirs = signed_distance(mesh.vertices, mesh.faces, N)
    near = abs(theirs) < 2 * CELL
    assert np.allclose(phi[near], theirs[near], atol=1e-6)
    assert ((phi < 0) == (theirs < 0)).all()
    seen = theirs < REACH_CELLS * CELL
    error = (abs(phi) - exact(mesh))[seen] / CELL
    assert error.min() > -1e-6 and error.max() < 0.5 and error.mean() < 0.03, "of a cell"
    far = theirs > (REACH_CELLS + SPARE_CELLS) * CELL
    assert np.allclose(phi[far], theirs[far], atol=1e-6)


def test_derivatives_against_differences() -> None:
    """Of a sum over all samples near and inside, searched anew at either end of the difference."""
    mesh = body()
    vertices = tensor(mesh.vertices, requires_grad=True)
    phi = MeshDistance(mesh.faces, N)(vertices)
    rng = np.random.default_rng(1)
    weight = tensor(rng.normal(size=(1, N, N, N))) * (phi.detach().abs() < 2 * CELL)
    (gradient,) = torch.autograd.grad((weight * phi).sum(), vertices)
    for _ in range(3):
        direction = tensor(rng.normal(size=mesh.vertices.shape))
        step = 1e-5
        sums = [
            float((weight * MeshDistance(mesh.faces, N)((vertices + s * step * direction).detach())).sum())
            for s in (1, -1)
        ]
        assert float((gradient * direction).sum()) == pytest.approx((sums[0] - sums[1]) / (2 * step), rel=2e-2)


def test_a_plane_moves_as_a_whole() -> None:
    """Moving the top of a box outwards lowers Φ below and above it by as much, and nothing at its sides."""
    box = trimesh.creation.box((1.3, 1.5, 1.1)).subdivide().subdivide()
    vertices = tensor(box.vertices, requires_grad=True)
    phi = MeshDistance(box.faces, N)(vertices)[0]
    up = tensor(np.where(np.isclose(box.vertices[:, [1]], 0.75), [[0, 1, 0]], 0.0))
    for place, slope in (((16, 27, 16), -1.0), ((16, 29, 16), -1.0), ((16, 5, 16), 0.0), ((16, 16, 26), 0.0)):
        (gradient,) = torch.autograd.grad(phi[place], vertices, retain_graph=True)
        assert float((gradient * up).sum()) == pytest.approx(slope, abs=1e-6)


def test_between_two_searches_it_follows_the_surface() -> None:
    """Over one cell, so that samples change sides; the next search makes it exact again."""
    mesh = body()
    distance = MeshDistance(mesh.faces, N, every=3)
    distance(tensor(mesh.vertices))
    moved = trimesh.Trimesh(mesh.vertices + CELL * mesh.vertex_normals, mesh.faces, process=False)
    right = signed_distance(moved.vertices, moved.faces, N)
    assert (right < 0).sum() - (signed_distance(mesh.vertices, mesh.faces, N) < 0).sum() > 1000
    near = abs(right) < 1.5 * CELL
    for searched in (False, False, True):
        error = abs(distance(tensor(moved.vertices))[0].numpy() - right)[near] / CELL
        assert error.max() < (1e-4 if searched else 0.3)
        assert error.mean() < (1e-5 if searched else 0.02)


def test_samples_on_the_surface() -> None:
    """Where x = c there is no direction from c to x; the normal of the face takes its place."""
    box = trimesh.creation.box((1.0, 1.0, 1.0)).subdivide()
    vertices = tensor(box.vertices, requires_grad=True)
    phi = MeshDistance(box.faces, N)(vertices)[0]
    assert phi[16, 24, 17].item() == pytest.approx(0, abs=1e-12)
    (gradient,) = torch.autograd.grad(phi[16, 24, 17], vertices)
    assert torch.isfinite(gradient).all()
    assert np.allclose(gradient.sum(dim=0), [0, -1, 0], atol=1e-6)


def test_gradient_of_mean_and_variance_of_the_stress() -> None:
    """∂E(σ̂)/∂vertices and ∂Var(σ̂)/∂vertices through Φ and a network, within 2 % of central differences."""
    torch.manual_seed(0)
    net = StressNetwork(Architecture(4, block_size=2, poolings=2, grid=N)).double()
    mesh = body()
    vertices = tensor(mesh.vertices, requires_grad=True)
    distance = MeshDistance(mesh.faces, N, every=1000)
    with torch.no_grad():
        phi = distance(vertices)
        inside, box = phi <= 0, crop_box(phi)

    def moments(place: torch.Tensor) -> torch.Tensor:
        field = compute.stress(net, distance(place), bfloat16=False, box=box)[inside]
        return torch.stack([field.mean(), field.var()])

    gradients = [torch.autograd.grad(m, vertices, retain_graph=True)[0] for m in moments(vertices)]
    step = 1e-7
    for direction in (tensor(mesh.vertex_normals), tensor(np.sin(3 * mesh.vertices))):
        with torch.no_grad():
            slopes = (moments(vertices + step * direction) - moments(vertices - step * direction)) / (2 * step)
        for gradient, slope in zip(gradients, slopes):
            assert float((gradient * direction).sum()) == pytest.approx(float(slope), rel=0.02)


def test_refusals() -> None:
    mesh = body()
    with pytest.raises(SolidError, match="not numbers"):
        MeshDistance(mesh.faces, N)(tensor(np.full_like(mesh.vertices, np.nan)))
    with pytest.raises(SolidError, match="encloses nothing"):
        MeshDistance(mesh.faces[:, ::-1], N)(tensor(mesh.vertices))

"""Implicit diffusion and the low-pass filter: against SciPy, against waves."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.sparse import identity
from scipy.sparse.linalg import spsolve
from toys import noise, sphere

from genmf_mi.geometry.laplacian import ImplicitDiffusion, cotangent_laplacian, laplacian
from genmf_mi.geometry.low_pass import LowPass, low_frequency
from genmf_mi.mesh.refine import halve_edges


class TestImplicitDiffusion:
    def test_laplacian_is_valence_minus_adjacency(self):
        """A tetrahedron, and two triangles with a boundary."""
        closed = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]])
        np.testing.assert_array_equal(laplacian(closed, 4).toarray(), 4 * np.eye(4) - 1)
        open_ = laplacian(np.array([[0, 1, 2], [2, 1, 3]]), 4).toarray()
        np.testing.assert_array_equal(open_, [[2, -1, -1, 0], [-1, 3, -1, -1], [-1, -1, 3, -1], [0, -1, -1, 2]])
        path = laplacian(np.array([[0, 1], [1, 2]]), 3).toarray()
        np.testing.assert_array_equal(path, [[1, -1, 0], [-1, 2, -1], [0, -1, 1]])

    @pytest.mark.parametrize("smoothing", [0.0, 1.0, 30.0])
    def test_against_scipy(self, smoothing):
        vertices, faces, _ = sphere()
        u = noise(len(vertices), 3)
        matrix = (identity(len(vertices)) + smoothing * laplacian(faces, len(vertices))).tocsc()
        diffusion = ImplicitDiffusion.large_steps(faces, len(vertices), smoothing)
        solved = diffusion(torch.tensor(u, dtype=torch.float32))
        np.testing.assert_allclose(solved, spsolve(matrix, u), atol=2e-6 * np.abs(u).max())
        np.testing.assert_allclose(diffusion.inverse(solved), u, atol=1e-4)

    def test_gradient(self):
        """The adjoint of a symmetric solve is the same solve; torch may hand over a tensor that is not contiguous."""
        vertices, faces, _ = sphere()
        weight = noise(3, len(vertices))
        u = torch.zeros(len(vertices), 3, requires_grad=True)
        (
            ImplicitDiffusion.large_steps(faces, len(vertices), 30.0)(u) * torch.tensor(weight, dtype=torch.float32).T
        ).sum().backward()
        matrix = (identity(len(vertices)) + 30 * laplacian(faces, len(vertices))).tocsc()
        np.testing.assert_allclose(u.grad, spsolve(matrix, weight.T), atol=1e-5)


@pytest.mark.parametrize(("waves", "kept"), [(1, (0.8, 1)), (40, (0, 0.05))])
def test_low_frequency(waves, kept):
    """Of a wave of 6.3 on a sphere of radius 1 most, of one of 0.16 nearly nothing; the border is 0.6."""
    vertices, faces, _ = sphere(5)
    field = np.sin(waves * vertices[:, 1])
    near_equator = np.abs(vertices[:, 1]) < 0.5
    smooth = low_frequency(vertices, faces, field, 0.6)
    share = (smooth * field)[near_equator].sum() / (field**2)[near_equator].sum()
    assert kept[0] <= share <= kept[1]


def test_cotangent_laplacian_against_a_loop():
    vertices, faces, _ = sphere(1)
    expected = np.zeros((len(vertices),) * 2)
    for face in faces:
        for k in range(3):
            i, j, apex = face[(k + 1) % 3], face[(k + 2) % 3], face[k]
            a, b = vertices[i] - vertices[apex], vertices[j] - vertices[apex]
            weight = a @ b / np.linalg.norm(np.cross(a, b)) / 2
            expected[[i, j], [j, i]] -= weight
            expected[[i, j], [i, j]] += weight
    assert (expected[~np.eye(len(vertices), dtype=bool)] <= 1e-12).all(), "no obtuse triangles here"
    np.testing.assert_allclose(cotangent_laplacian(vertices, faces).toarray(), expected, atol=1e-12)


def test_cotangent_laplacian_has_no_negative_weights():
    vertices = np.array([[0, 0, 0], [4, 0, 0], [2, 0.2, 0], [2, -3, 0.0]])
    matrix = cotangent_laplacian(vertices, np.array([[0, 1, 2], [1, 0, 3]])).toarray()
    assert (matrix - np.diag(np.diag(matrix)) <= 0).all() and np.allclose(matrix.sum(axis=1), 0)


def test_low_pass_does_not_depend_on_the_triangles():
    """The same field on a sphere, and on one with triangles of half the size on one side."""
    vertices, faces, _ = sphere(4)
    fine, triangles = halve_edges(vertices, faces, vertices[faces].mean(axis=1)[:, 0] > 0)
    field = np.sin(8 * fine[:, 1])
    even = low_frequency(vertices, faces, field[: len(vertices)], 0.8)
    uneven = low_frequency(fine, triangles, field, 0.8)
    assert np.abs(even).max() > 0.2
    np.testing.assert_allclose(uneven[: len(vertices)], even, atol=0.03)


def test_low_pass_keeps_a_constant():
    vertices, faces, _ = sphere()
    ones = torch.ones(len(vertices), 2)
    np.testing.assert_allclose(LowPass(vertices, faces, 0.5)(ones), ones, atol=1e-5)

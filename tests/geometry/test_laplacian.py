"""Implicit diffusion and the low-pass filter: against SciPy, against waves."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.sparse import identity
from scipy.sparse.linalg import spsolve
from toys import noise, sphere

from genmf_mi.geometry.laplacian import ImplicitDiffusion, laplacian
from genmf_mi.geometry.low_pass import low_frequency


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
        diffusion = ImplicitDiffusion(faces, len(vertices), smoothing)
        solved = diffusion(torch.tensor(u, dtype=torch.float32))
        np.testing.assert_allclose(solved, spsolve(matrix, u), atol=2e-6 * np.abs(u).max())
        np.testing.assert_allclose(diffusion.inverse(solved), u, atol=1e-4)

    def test_gradient(self):
        """The adjoint of a symmetric solve is the same solve; torch may hand over a tensor that is not contiguous."""
        vertices, faces, _ = sphere()
        weight = noise(3, len(vertices))
        u = torch.zeros(len(vertices), 3, requires_grad=True)
        (
            ImplicitDiffusion(faces, len(vertices), 30.0)(u) * torch.tensor(weight, dtype=torch.float32).T
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

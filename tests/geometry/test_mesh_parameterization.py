"""Relief as bounded offsets of a mesh: bounds, filter, start, derivatives."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from toys import noise, sphere

from genmf_mi.geometry.displacement_bounds import DisplacementBounds
from genmf_mi.geometry.low_pass import LowPass
from genmf_mi.geometry.mesh import MeshParameterization

NORMALS = sphere()[2]


def bounded(*, filtered: bool = False) -> tuple[MeshParameterization, DisplacementBounds]:
    """A sphere whose vertices have bounds of different size, some none at all."""
    vertices, faces, normals = sphere()
    rng = np.random.default_rng(0)
    bounds = [rng.uniform(0.001, 0.02, len(vertices)) for _ in range(3)]
    for x in bounds:
        x[::7] = 0
    bounds = DisplacementBounds(*bounds)
    smooth = LowPass(vertices, faces, 0.4) if filtered else None
    return MeshParameterization(vertices, normals, faces, bounds, smoothing=5.0, low_pass=smooth), bounds


class TestMeshParameterization:
    @pytest.mark.parametrize("filtered", [False, True])
    @pytest.mark.parametrize("size", [0.0, 1e-8, 1e-3, 1.0, 1e4, 1e12, 1e30])
    def test_never_beyond_the_bounds(self, size, filtered):
        """Whatever the optimiser does to the parameter."""
        part, bounds = bounded(filtered=filtered)
        with torch.no_grad():
            part.parameters[0].copy_(torch.tensor(size * noise(*part.parameters[0].shape), dtype=torch.float32))
        offsets = part.offsets().detach().numpy().astype(np.float64)
        normals = NORMALS
        height = (offsets * normals).sum(axis=1)
        across = np.linalg.norm(offsets - height[:, None] * normals, axis=1)
        slack = 1e-6 * 0.02 + 1e-8
        assert np.isfinite(offsets).all()
        assert (height <= bounds.outward + slack).all()
        assert (-height <= bounds.inward + slack).all()
        assert (across <= bounds.tangential + slack).all()
        assert np.abs(offsets[::7]).max() < 1e-8
        if size == 1e4:  # and most of the bounds can be used
            used = np.abs(height) / np.where(height > 0, bounds.outward, bounds.inward).clip(1e-9)
            assert np.median(used) > 0.9

    def test_small_parameters_are_not_squashed(self):
        part, _ = bounded()
        with torch.no_grad():
            part.parameters[0].copy_(torch.tensor(1e-6 * noise(*part.parameters[0].shape), dtype=torch.float32))
            free = torch.arange(len(part.initial_shape)) % 7 != 0
            torch.testing.assert_close(
                part.offsets()[free], part._diffusion(part.parameters[0])[free], rtol=2e-3, atol=1e-9
            )

    def test_low_frequencies_are_taken_out(self):
        """To raise the whole surface is of no use; a vertex among its neighbours may rise."""
        part, bounds = bounded(filtered=True)
        with torch.no_grad():
            part.parameters[0].copy_(0.01 * torch.tensor(NORMALS, dtype=torch.float32))
            assert part.offsets().abs().max() < 3e-4
            part.parameters[0].copy_(
                0.5
                * torch.tensor(NORMALS, dtype=torch.float32)
                * (torch.arange(len(part.initial_shape)) == 100)[:, None]
            )
            heights = (part.offsets() * torch.tensor(NORMALS, dtype=torch.float32)).sum(dim=1)
        assert heights.argmax() == 100 and heights[100] > 0.3 * bounds.outward[100]

    def test_set_heights(self):
        part, bounds = bounded()
        share = np.random.default_rng(1).uniform(-0.97, 0.97, len(part.initial_shape))
        heights = share * np.where(share > 0, bounds.outward, bounds.inward)
        part.set_heights(heights)
        np.testing.assert_allclose(part.offsets().detach(), heights[:, None] * NORMALS, atol=1e-6)
        torch.testing.assert_close(part.geometry().vertices, part.initial_shape + part.offsets())

    def test_heights_beyond_the_bounds_are_cut(self):
        part, bounds = bounded()
        part.set_heights(np.full(len(part.initial_shape), 1.0))
        np.testing.assert_allclose(part.offsets().detach(), 0.98 * bounds.outward[:, None] * NORMALS, atol=1e-5)

    @pytest.mark.parametrize("filtered", [False, True])
    def test_gradient_against_finite_differences(self, filtered):
        part, _ = bounded(filtered=filtered)
        weight = torch.tensor(noise(*part.parameters[0].shape, seed=1), dtype=torch.float32)
        start = torch.tensor(0.01 * noise(*part.parameters[0].shape, seed=2), dtype=torch.float32)
        direction = torch.tensor(noise(*part.parameters[0].shape, seed=3), dtype=torch.float32)

        def value(shift: float) -> torch.Tensor:
            with torch.no_grad():
                part.parameters[0].copy_(start + shift * direction)
            return (part.offsets() * weight).sum()

        difference = (value(2e-4) - value(-2e-4)).item() / 4e-4
        value(0).backward()
        assert (part.parameters[0].grad * direction).sum().item() == pytest.approx(difference, rel=5e-3)

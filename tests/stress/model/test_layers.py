"""The layers of the stress network: against slow obvious ones, odd sizes, symmetries; cooling against the solver."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import torch
import trimesh
from stress_samples import lopsided, ticks

from genmf_mi.core.frame import HALF_EXTENT
from genmf_mi.stress.data.reader import apply_symmetry
from genmf_mi.stress.fem.grid import to_grid
from genmf_mi.stress.fem.materials import material
from genmf_mi.stress.fem.simulation import Settings, simulate
from genmf_mi.stress.model import layers
from genmf_mi.stress.model.cooling import relative_cooling


def slow_geometry(phi: np.ndarray, cell: float) -> np.ndarray:
    """The five channels, one sample and one difference after the other."""
    n = phi.shape
    phi = np.minimum(phi, layers.REACH_CELLS * cell)
    result = np.zeros((5, *n))
    weight = {-1: 0.25, 0: 0.5, 1: 0.25}

    def at(i, j, k):
        return phi[tuple(np.clip((i, j, k), 0, np.array(n) - 1))]

    for place in itertools.product(*map(range, n)):
        gradient, laplacian = np.zeros(3), 0.0
        for axis in range(3):
            others = [a for a in range(3) if a != axis]
            for first, second in itertools.product(weight, weight):
                here = list(place)
                here[others[0]] += first
                here[others[1]] += second
                before, after = list(here), list(here)
                before[axis] -= 1
                after[axis] += 1
                w = weight[first] * weight[second]
                gradient[axis] += w * (at(*after) - at(*before)) / (2 * cell)
                laplacian += w * (at(*after) - 2 * at(*here) + at(*before)) / cell
        normal = gradient / np.sqrt((gradient**2).sum() + layers.GeometricGradient.SOFT**2)
        result[(slice(None), *place)] = [phi[place], *normal, laplacian]
    return result


def test_geometry_against_loops() -> None:
    phi = np.random.default_rng(0).normal(scale=0.1, size=(5, 6, 7)).astype(np.float32)
    fast = layers.GeometricGradient(0.05)(torch.from_numpy(phi)[None, None])[0]
    assert np.allclose(fast, slow_geometry(phi, 0.05), atol=1e-4)


def test_geometry_of_a_ball() -> None:
    x, y, z = ticks(65)
    radius = np.sqrt(x**2 + y**2 + z**2)
    cell = 2 / 64
    features = layers.GeometricGradient(cell)(torch.tensor(radius - 0.6, dtype=torch.float32)[None, None])[0].numpy()
    near = abs(radius - 0.6) < 2 * cell
    outwards = np.stack([x, y, z]) / np.maximum(radius, 1e-9)
    assert np.allclose(features[0][near], (radius - 0.6)[near], atol=1e-6)
    assert ((features[1:4] * outwards).sum(axis=0)[near] > 0.99).all()
    assert np.allclose(features[4][near], 2 * cell / radius[near], rtol=0.02), "twice the mean curvature"
    assert features[0].max() == pytest.approx(layers.REACH_CELLS * cell)


@pytest.mark.parametrize("symmetry", range(8))
def test_geometry_turns_with_the_body(symmetry: int) -> None:
    phi = lopsided(17)[0].numpy()
    layer = layers.GeometricGradient(2 / 16)

    def features(field: np.ndarray) -> np.ndarray:
        return layer(torch.from_numpy(field)[None, None])[0].numpy()

    moved = np.stack([apply_symmetry(channel, symmetry) for channel in features(phi)])
    # What turning an image of the coordinates does to them is what it does to a vector.
    corners = [apply_symmetry(np.asarray(c), symmetry)[[0, -1, 0, 0], [0, 0, -1, 0], [0, 0, 0, -1]] for c in ticks(17)]
    steps = np.array([[c[i] - c[0] for i in (1, 2, 3)] for c in corners]) / 2
    moved[1:4] = np.einsum("ij,i...->j...", steps, moved[1:4])
    assert np.allclose(features(apply_symmetry(phi, symmetry)), moved, atol=1e-5)


def test_blocks() -> None:
    field = torch.rand(2, 3, 4, 6, 8)
    blocks = layers.space_to_depth(field, 2)
    assert blocks.shape == (2, 24, 2, 3, 4)
    assert torch.equal(layers.depth_to_space(blocks, 2), field)
    for channel, (i, j, k) in enumerate(itertools.product(range(2), repeat=3)):
        assert torch.equal(blocks[:, 8 + channel], field[:, 1, i::2, j::2, k::2])


def test_residual_block() -> None:
    x = torch.randn(2, 3, 4, 5, 6)
    same, wider = layers.Res3DBlock(3, 3), layers.Res3DBlock(3, 8)
    assert wider(x).shape == (2, 8, 4, 5, 6)
    for parameter in same.second_norm.parameters():
        torch.nn.init.zeros_(parameter)
    assert torch.equal(same(x), x.relu()), "without F it is the identity and a ReLU"

    def slow(x: np.ndarray) -> np.ndarray:
        """Instance normalisation over the three axes of space."""
        axes = (2, 3, 4)
        return (x - x.mean(axes, keepdims=True)) / np.sqrt(x.var(axes, keepdims=True) + 1e-5)

    with torch.no_grad():
        inner = np.maximum(slow(wider.first(x).numpy()), 0)
        inner = slow(wider.second(torch.from_numpy(inner)).numpy()) + wider.identity(x).numpy()
        assert np.allclose(wider(x).numpy(), np.maximum(inner, 0), atol=1e-4)


def test_small_fields_are_convolved_in_full_precision() -> None:
    """Gradients too: on a few samples those of bfloat16 kernels cannot be relied on."""
    block, small, large = layers.Res3DBlock(3, 4), torch.randn(1, 3, 2, 3, 4), torch.randn(1, 3, 4, 4, 4)
    with torch.autocast("cpu", torch.bfloat16):
        assert block(small).dtype == torch.float32 and torch.equal(block(small), block.float()(small))
        assert block.first(large).dtype == torch.bfloat16
        block(small.bfloat16()).sum().backward()
    assert all(p.grad.isfinite().all() for p in block.parameters())


def test_recalibration_and_global_descriptor() -> None:
    x = torch.rand(2, 16, 3, 4, 5) + 0.1
    scaled = layers.SqueezeExcitation(16)(x) / x
    assert torch.allclose(scaled, scaled[:, :, :1, :1, :1].expand_as(scaled), atol=1e-5)
    assert scaled.min() > 0 and scaled.max() < 1
    fused = layers.with_global_descriptor(x)
    assert torch.allclose(fused[1, 7], x[1, 7] + x[1, 7].mean())


@pytest.mark.parametrize("shape", [(8, 8, 8), (9, 10, 11), (17, 8, 13)])
def test_up_meets_skips_of_odd_size(shape: tuple[int, int, int]) -> None:
    skip = torch.rand(1, 4, *shape)
    low = torch.nn.functional.max_pool3d(torch.rand(1, 8, *shape), 2)
    assert layers.UpBlock(8, 4)(low, skip).shape == skip.shape


@pytest.mark.parametrize(("size_mm", "name", "error_k"), [(100.0, "pla", 1.0), (50.0, "petg", 5.0)])
def test_cooling_against_finite_elements(size_mm: float, name: str, error_k: float) -> None:
    """Of the given size and material: of PLA within a kelvin; half the size of PETG has cooled by 14, within 5."""
    settings = Settings(size_mm=size_mm, edge_mm=0.06 * size_mm, grid=65, material=name)
    ball = trimesh.creation.icosphere(subdivisions=3)
    simulation = simulate(ball.vertices * [1.0, 0.6, 0.8], ball.faces, settings)
    temperature, _ = to_grid(simulation.mesh, simulation.field.temperature, simulation.phi)
    cell, stuff = 2 / 64, material(name)
    phi = torch.from_numpy(simulation.phi[:64, :64, :64])[None, None]
    cell_mm = cell * size_mm / (2 * HALF_EXTENT)
    cooling = relative_cooling(phi, cell, 2, cell_mm, stuff, settings.protocol)[0, 0].numpy()
    inside = (simulation.phi[:64, :64, :64] <= 0).reshape(32, 2, 32, 2, 32, 2).all(axis=(1, 3, 5))
    true = temperature[:64, :64, :64].reshape(32, 2, 32, 2, 32, 2).mean(axis=(1, 3, 5))[inside]
    range_k = stuff.stress_free_celsius - settings.protocol.ambient_end_celsius
    predicted = stuff.stress_free_celsius - cooling[inside] * range_k
    assert stuff.stress_free_celsius - true.mean() > 2.5 * error_k
    assert np.abs(predicted - true).mean() < error_k


def test_physics_asks_for_the_part() -> None:
    """Cooling and clamp are those of the settings; the height is not."""
    phi = lopsided(33)[None, :, :32, :32, :32]
    physics = layers.Physics(2 / 32, 2)
    large, small, other = (
        physics(phi, settings) for settings in (Settings(), Settings(size_mm=50.0), Settings(material="petg"))
    )
    inside = large[:, :1] > 0.1
    assert (small[:, :1][inside] > 1.1 * large[:, :1][inside]).all(), "half the size cools faster"
    assert not torch.allclose(other[:, :1], large[:, :1], rtol=0.05)
    assert torch.equal(small[:, 1:], large[:, 1:])


def test_cooling_has_its_derivative_with_respect_to_distance() -> None:
    """Φ itself is differentiated here, as `Predictor.field` allows; against central differences."""
    n, cell = 16, 2 / 15
    axis = torch.linspace(-1, 1, n, dtype=torch.float64)
    x, y, z = torch.meshgrid(axis, axis, axis, indexing="ij")
    phi = ((x / 0.8) ** 2 + (y / 0.7) ** 2 + (z / 0.6) ** 2).sqrt()[None, None] - 1
    direction = torch.randn(phi.shape, dtype=phi.dtype, generator=torch.Generator().manual_seed(0))

    def mean(field: torch.Tensor) -> torch.Tensor:
        return relative_cooling(field, cell, 2, 6.0, material("pla"), Settings().protocol).square().mean()

    leaf = phi.clone().requires_grad_()
    (gradient,) = torch.autograd.grad(mean(leaf), leaf)
    step = 1e-6
    difference = (mean(phi + step * direction) - mean(phi - step * direction)) / (2 * step)
    assert float((gradient * direction).sum()) == pytest.approx(float(difference), rel=1e-4)

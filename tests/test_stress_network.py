"""The stress network: its layers against slow obvious ones, odd sizes, symmetries, and gradients that are true."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import torch

from genmf_mi.core.errors import ConfigError
from genmf_mi.stress.data.reader import turned
from genmf_mi.stress.model import compute, layers
from genmf_mi.stress.model.network import Architecture, StressNetwork, network, to_stress, to_target, window

TINY = Architecture(4, block_size=2, poolings=2, grid=33)


def grid(n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    ticks = np.linspace(-1, 1, n)
    return tuple(np.meshgrid(ticks, ticks, ticks, indexing="ij"))


def body(n: int = 33) -> torch.Tensor:
    """Two balls of different size that overlap, ``[1,n,n,n]``, without a symmetry."""
    x, y, z = grid(n)
    one = np.sqrt((x - 0.1) ** 2 + (y + 0.2) ** 2 + (z + 0.3) ** 2) - 0.5
    two = np.sqrt((x + 0.2) ** 2 + (y - 0.4) ** 2 + (z - 0.1) ** 2) - 0.3
    return torch.tensor(np.minimum(one, two), dtype=torch.float32)[None]


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
    x, y, z = grid(65)
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
    phi = body(17)[0].numpy()
    layer = layers.GeometricGradient(2 / 16)

    def features(field: np.ndarray) -> np.ndarray:
        return layer(torch.from_numpy(field)[None, None])[0].numpy()

    moved = np.stack([turned(channel, symmetry) for channel in features(phi)])
    # What turning an image of the coordinates does to them is what it does to a vector.
    corners = [turned(np.asarray(c), symmetry)[[0, -1, 0, 0], [0, 0, -1, 0], [0, 0, 0, -1]] for c in grid(17)]
    steps = np.array([[c[i] - c[0] for i in (1, 2, 3)] for c in corners]) / 2
    moved[1:4] = np.einsum("ij,i...->j...", steps, moved[1:4])
    assert np.allclose(features(turned(phi, symmetry)), moved, atol=1e-5)


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
    block, small, large = layers.Res3DBlock(3, 4), torch.randn(1, 3, 2, 4, 4), torch.randn(1, 3, 8, 8, 8)
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
    assert layers.Up(8, 4)(low, skip).shape == skip.shape


def test_the_paper_network_at_full_size() -> None:
    """129 → 64 → 32 → 16 → 8 and back, with the number of parameters that the paper's figures give; no memory used."""
    with torch.device("meta"):
        net = network("paper")
        sides = []
        for block in net.down:
            block.register_forward_hook(lambda module, inputs, output: sides.append(tuple(output.shape[1:3])))
        assert net(torch.empty(1, 1, 129, 129, 129)).shape == (1, 1, 129, 129, 129)
    assert sides == [(56, 129), (112, 64), (224, 32), (448, 16), (448, 8)]
    assert sum(p.numel() for p in net.parameters()) == pytest.approx(46.6e6, rel=0.005)


@pytest.mark.parametrize("shape", [(8, 8, 16), (9, 13, 17), (32, 33, 34)])
@pytest.mark.parametrize("side", [1, 2])
def test_any_size(shape: tuple[int, int, int], side: int) -> None:
    net = StressNetwork(Architecture(4, side, poolings=2, grid=33))
    assert net(torch.randn(1, 1, *shape)).shape == (1, 1, *shape)


def test_refusals() -> None:
    with pytest.raises(ConfigError, match="at least 8"):
        StressNetwork(TINY)(torch.zeros(1, 1, 33, 7, 33))
    with pytest.raises(ConfigError, match="one of 16"):
        StressNetwork(TINY)(torch.zeros(1, 1, 8, 8, 15))
    with pytest.raises(ConfigError, match=r"\[B,1,X,Y,Z\]"):
        StressNetwork(TINY)(torch.zeros(1, 2, 33, 33, 33))
    with pytest.raises(ConfigError, match="preset"):
        network("huge")
    with pytest.raises(ConfigError, match="too small"):
        Architecture(4, block_size=2, poolings=4, grid=17)
    with pytest.raises(ConfigError, match="at least 1"):
        Architecture(0)
    with pytest.raises(ConfigError, match="no body"):
        window(torch.ones(1, 33, 33, 33))


def test_window() -> None:
    phi = torch.ones(1, 1, 129, 129, 129)
    phi[..., 3:126, 40:62, 20:80] = -1
    assert window(phi) == (slice(0, 128), slice(36, 68), slice(16, 96))
    phi[..., 0, 50, 50] = -1
    phi[..., 128, 50, 50] = -1
    assert window(phi)[0] == slice(0, 129), "an axis without room is taken whole"
    small = torch.ones(33, 33, 33)
    small[16, 16, 16] = -1
    assert all(s.stop - s.start == 32 and s.start <= 16 < s.stop for s in window(small)), "never less than is pooled"


def test_target_and_back() -> None:
    stress = torch.tensor([0.0, 0.3, 3.0, 30.0])
    assert torch.allclose(to_target(stress), torch.tensor(np.log(1 + stress.numpy() / 3)))
    assert torch.allclose(to_stress(to_target(stress)), stress, atol=1e-5)


def test_a_batch_is_its_members() -> None:
    torch.manual_seed(0)
    net = StressNetwork(TINY)
    both = torch.stack([body(), body().flip(1)])
    assert torch.allclose(net(both), torch.cat([net(both[:1]), net(both[1:])]), atol=1e-5)


def test_stress_is_zero_outside_of_the_window() -> None:
    net = StressNetwork(TINY)
    box = (slice(0, 32), slice(4, 20), slice(8, 32))
    field = compute.stress(net, body(), bfloat16=False, box=box)
    assert field.shape == (1, 33, 33, 33) and (field >= 0).all()
    field[(0, *box)] = 0
    assert (field == 0).all()


def test_gradient_with_respect_to_the_distance() -> None:
    """∂ mean σ/∂Φ along a few directions, in double precision against central differences."""
    torch.manual_seed(1)
    net = StressNetwork(TINY).double()
    phi = body().double().requires_grad_()
    inside, box = phi.detach() <= 0, window(phi)

    def mean(field: torch.Tensor) -> torch.Tensor:
        return compute.stress(net, field, bfloat16=False, box=box)[inside].mean()

    (gradient,) = torch.autograd.grad(mean(phi), phi)
    generator = torch.Generator().manual_seed(2)
    for _ in range(3):
        direction = torch.randn(phi.shape, generator=generator, dtype=torch.float64) * (phi.detach().abs() < 0.2)
        step = 1e-8  # so small that hardly a ReLU changes its mind
        with torch.no_grad():
            slope = (mean(phi + step * direction) - mean(phi - step * direction)) / (2 * step)
        assert float((gradient * direction).sum()) == pytest.approx(float(slope), rel=1e-3)


def test_lower_precision_is_close() -> None:
    torch.manual_seed(0)
    net = StressNetwork(TINY)
    phi = body()[None]
    exact, rough = (compute.log_stress(net, phi, bfloat16=b) for b in (False, True))
    assert rough.dtype == torch.float32
    assert (exact - rough).abs().max() < 0.1 * exact.abs().max()


def test_precision_and_device() -> None:
    cpu = torch.device("cpu")
    assert compute.bfloat16_on(cpu, "bfloat16") and not compute.bfloat16_on(cpu, "float32")
    assert compute.device_of("cpu") == cpu
    if not torch.cuda.is_available():
        assert compute.device_of("auto") == cpu
        with pytest.raises(ConfigError, match="no CUDA"):
            compute.device_of("cuda")

"""The stress network: odd sizes, crops, gradients that are true, precision and device."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from jaxtyping import TypeCheckError
from stress_samples import lopsided

from genmf_mi.core.errors import ConfigError
from genmf_mi.stress.model import compute
from genmf_mi.stress.model.network import (
    Architecture,
    StressNetwork,
    build_network,
    crop_box,
    to_stress,
    to_target,
)

TINY = Architecture(4, block_size=2, poolings=2, grid=33)


def test_the_paper_network_at_full_size() -> None:
    """129 → 64 → 32 → 16 → 8 and back, with the number of parameters that the paper's figures give; no memory used."""
    with torch.device("meta"):
        net = build_network("paper")
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
    with pytest.raises(TypeCheckError, match="batch 1 x y z"):
        StressNetwork(TINY)(torch.zeros(1, 2, 33, 33, 33))
    with pytest.raises(ConfigError, match="preset"):
        build_network("huge")
    with pytest.raises(ConfigError, match="too small"):
        Architecture(4, block_size=2, poolings=4, grid=17)
    with pytest.raises(ConfigError, match="at least 1"):
        Architecture(0)
    with pytest.raises(ConfigError, match="no body"):
        crop_box(torch.ones(1, 33, 33, 33))


def test_crop_box() -> None:
    phi = torch.ones(1, 1, 129, 129, 129)
    phi[..., 3:126, 40:62, 20:80] = -1
    assert crop_box(phi) == (slice(0, 128), slice(36, 68), slice(16, 96))
    phi[..., 0, 50, 50] = -1
    phi[..., 128, 50, 50] = -1
    assert crop_box(phi)[0] == slice(0, 129), "an axis without room is taken whole"
    small = torch.ones(33, 33, 33)
    small[16, 16, 16] = -1
    assert all(s.stop - s.start == 32 and s.start <= 16 < s.stop for s in crop_box(small)), "never less than is pooled"


def test_target_and_back() -> None:
    stress = torch.tensor([0.0, 0.3, 3.0, 30.0])
    assert torch.allclose(to_target(stress), torch.tensor(np.log(1 + stress.numpy() / 3)))
    assert torch.allclose(to_stress(to_target(stress)), stress, atol=1e-5)


def test_a_batch_is_its_members() -> None:
    torch.manual_seed(0)
    net = StressNetwork(TINY)
    both = torch.stack([lopsided(), lopsided().flip(1)])
    assert torch.allclose(net(both), torch.cat([net(both[:1]), net(both[1:])]), atol=1e-5)


def test_stress_is_zero_outside_of_the_crop_box() -> None:
    net = StressNetwork(TINY)
    box = (slice(0, 32), slice(4, 20), slice(8, 32))
    field = compute.stress(net, lopsided(), bfloat16=False, box=box)
    assert field.shape == (1, 33, 33, 33) and (field >= 0).all()
    field[(0, *box)] = 0
    assert (field == 0).all()


def test_gradient_with_respect_to_the_distance() -> None:
    """∂ mean σ/∂Φ along a few directions, in double precision against central differences."""
    torch.manual_seed(1)
    net = StressNetwork(TINY).double()
    phi = lopsided().double().requires_grad_()
    inside, box = phi.detach() <= 0, crop_box(phi)

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
    phi = lopsided()[None]
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

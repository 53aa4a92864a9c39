"""The coarse stress as an input of the network: what it adds to it, where it comes from, and who needs it."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
import torch
from stress_samples import N, ball, write_samples

from genmf_mi.core.errors import ConfigError
from genmf_mi.stress.data import reader
from genmf_mi.stress.fem.coarse import coarse_stress
from genmf_mi.stress.fem.settings import Settings
from genmf_mi.stress.model import compute, weights
from genmf_mi.stress.model.network import Architecture, StressNetwork, to_stress, to_target
from genmf_mi.stress.model.predictor import Predictor

EDGE_MM = 10.0
WITH_COARSE = Architecture(4, block_size=2, poolings=2, coarse_mm=EDGE_MM, grid=N)
SETTINGS = Settings(grid=N, size_mm=80.0)


@pytest.fixture(scope="module")
def phi() -> np.ndarray:
    return ball((0.9, 0.6, 0.7))


@pytest.fixture(scope="module")
def coarse(phi: np.ndarray) -> np.ndarray:
    return coarse_stress(torch.from_numpy(phi)[None], SETTINGS, EDGE_MM)[0].numpy()


def test_an_untrained_network_adds_nothing_of_its_own(coarse: np.ndarray, phi: np.ndarray) -> None:
    """What it is given comes back; odd sides too."""
    net = StressNetwork(WITH_COARSE)
    shape, field = (torch.from_numpy(x[None, None, :, :, 2:29]) for x in (phi, coarse))
    assert torch.equal(net(shape, field), to_target(field))


def test_is_required_by_networks_with_it_alone(coarse: np.ndarray, phi: np.ndarray) -> None:
    shape, field = (torch.from_numpy(x)[None, None] for x in (phi, coarse))
    with pytest.raises(ConfigError, match="coarse mesh"):
        StressNetwork(WITH_COARSE)(shape)
    with pytest.raises(ConfigError, match="coarse mesh"):
        StressNetwork(replace(WITH_COARSE, coarse_mm=0.0))(shape, field)
    net = StressNetwork(WITH_COARSE)
    torch.nn.init.normal_(net.fusion.out.weight)
    assert not torch.equal(net(shape, field) - to_target(field), net(shape, 2 * field) - to_target(2 * field))


def test_predictor_computes_it_unless_given(tmp_path: Path, coarse: np.ndarray, phi: np.ndarray) -> None:
    torch.manual_seed(0)
    weights.save(tmp_path / "w.safetensors", StressNetwork(WITH_COARSE), "compact", asdict(SETTINGS), {})
    predictor = Predictor(tmp_path / "w.safetensors", precision="float32")
    shape, field = torch.from_numpy(phi)[None], torch.from_numpy(coarse)[None]
    assert torch.allclose(predictor.coarse(shape), field, rtol=1e-4), "to the tolerance of the solver"
    assert torch.allclose(predictor.field(shape), predictor.field(shape, coarse=field), rtol=1e-3)
    assert not torch.equal(predictor.field(shape), predictor.field(shape, coarse=0.5 * field))
    net, _ = weights.load(tmp_path / "w.safetensors")
    expected = to_stress(compute.log_stress(net, shape[None], False, field[None]))[0].clamp_min(0)
    inside = shape <= 0
    assert torch.allclose(predictor.field(shape, box=(slice(0, N),) * 3)[inside], expected[inside], atol=1e-6)


def test_predictor_has_its_derivative(tmp_path: Path, phi: np.ndarray) -> None:
    """An untrained network adds nothing, so that all derivatives are those of the solver."""
    weights.save(tmp_path / "w.safetensors", StressNetwork(WITH_COARSE), "compact", asdict(SETTINGS), {})
    predictor = Predictor(tmp_path / "w.safetensors", precision="float32")
    gradients = []
    for field in (predictor.field, lambda shape: coarse_stress(shape, SETTINGS, EDGE_MM)):
        shape = torch.from_numpy(phi)[None].requires_grad_()
        field(shape)[shape.detach() <= 0].mean().backward()
        gradients.append(shape.grad)
    assert gradients[0].abs().max() > 0
    assert torch.allclose(*gradients, atol=1e-4 * float(gradients[1].abs().max()))


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_samples(tmp_path_factory.mktemp("coarse") / "data")


def test_samples_with_it(data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    solved = []

    def stand_in(phi: torch.Tensor, settings: Settings, edge_mm: float) -> torch.Tensor:
        assert (settings.grid, edge_mm) == (N, EDGE_MM)
        solved.append(phi)
        return phi - 2

    monkeypatch.setattr(reader, "coarse_stress", stand_in)
    samples = reader.StressSamples(data, "train", augment=True, cache=tmp_path, coarse_mm=EDGE_MM)
    torch.manual_seed(0)
    for _ in range(4):
        for item in (1, 2):
            phi, _, coarse = samples.with_coarse(item)
            assert torch.allclose(coarse + 2, phi, atol=2e-3), "in the same symmetry"
    assert len(solved) == 2, "kept in the cache"
    assert reader.StressSamples(data, "train").with_coarse(0)[2] is None

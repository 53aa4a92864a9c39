"""Weights as files: they come back, and what is wrong with others is said."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
import torch
from stress_samples import N, ball

from genmf_mi.stress.fem.simulation import Settings
from genmf_mi.stress.model import compute, network, weights
from genmf_mi.stress.model.network import Architecture, to_stress
from genmf_mi.stress.model.weights import WeightsError

TINY = Architecture(4, block_size=2, poolings=2)


@pytest.fixture(autouse=True)
def tiny(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(network.PRESETS, "compact", TINY)


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    torch.manual_seed(0)
    net = network.build_network("compact", N)
    path = tmp_path / "weights.safetensors"
    weights.save(path, net, "compact", asdict(Settings(grid=N)), {"steps_made": 1})
    return path


def test_weights_come_back(saved: Path) -> None:
    from safetensors.numpy import load_file

    torch.manual_seed(0)
    net = network.build_network("compact", N)
    again, about = weights.load(saved, preset="compact", simulation=asdict(Settings(grid=N, edge_mm=1.2)))
    assert about["preset"] == "compact" and about["training"] == {"steps_made": 1}
    phi = torch.from_numpy(ball((0.6, 0.9, 0.7)))[None, None]
    with torch.no_grad():
        assert torch.allclose(net(phi), again(phi), atol=0.01)
    raw = load_file(saved)
    assert raw.keys() == net.state_dict().keys() and {x.dtype for x in raw.values()} == {np.dtype("float16")}


def test_bad_weights(saved: Path, tmp_path: Path) -> None:
    with pytest.raises(WeightsError, match="does not exist"):
        weights.load(tmp_path / "none.safetensors")
    with pytest.raises(WeightsError, match="not 'paper'"):
        weights.load(saved, preset="paper")
    hot = asdict(Settings(grid=N, protocol=replace(Settings().protocol, heat_transfer_coefficient_w_m2k=10.0)))
    with pytest.raises(WeightsError, match="heat_transfer_coefficient_w_m2k"):
        weights.load(saved, simulation=hot)
    with pytest.raises(WeightsError, match="material"):
        weights.load(saved, simulation=asdict(Settings(grid=N, material="abs")))
    whole = saved.read_bytes()
    for damaged in (whole[:-100], whole[:50], b"", b"not at all"):
        saved.write_bytes(damaged)
        with pytest.raises(WeightsError, match="damaged"):
            weights.load(saved)
    from safetensors.torch import save_file

    save_file({"a": torch.zeros(1)}, saved)
    with pytest.raises(WeightsError, match="no stress network"):
        weights.load(saved)
    for header in ("[1]", "{", "[" * 100_000):
        save_file({"a": torch.zeros(1)}, saved, {weights.KEY: header})
        with pytest.raises(WeightsError, match="no stress network"):
            weights.load(saved)
    save_file({"a": torch.zeros(1)}, saved, {weights.KEY: json.dumps({"format": weights.FORMAT, "architecture": 3})})
    with pytest.raises(WeightsError, match="does not fit"):
        weights.load(saved)


def test_weights_that_do_not_fit_their_description(saved: Path) -> None:
    from safetensors import safe_open
    from safetensors.torch import load_file, save_file

    with safe_open(saved, framework="pt") as file:
        header = file.metadata()
    tensors = load_file(saved)
    tensors.pop("fusion.out.bias")
    save_file(tensors, saved, header)
    with pytest.raises(WeightsError, match="does not fit"):
        weights.load(saved)


def test_stress_of_a_prediction_is_not_negative() -> None:
    torch.manual_seed(3)
    net = network.build_network("compact", N)
    phi = torch.from_numpy(ball((0.6, 0.9, 0.7)))[None]
    assert (to_stress(net(phi[None])) < 0).any()
    field = compute.stress(net, phi, bfloat16=False)
    assert (field >= 0).all() and field.shape == phi.shape


def test_former_names_are_translated() -> None:
    """The weights of the package say ``side`` and ``film_w_m2k`` in their header, which their hash protects."""
    from safetensors import safe_open

    with safe_open(weights.file_of("compact"), framework="pt") as file:
        header = json.loads(file.metadata()[weights.KEY])
    assert header["architecture"]["side"] == 2 and header["simulation"]["protocol"]["film_w_m2k"] == 5.0
    net, about = weights.load("compact", preset="compact", simulation=asdict(Settings()))
    assert net.architecture == Architecture(24, block_size=2, physics=True, coarse_mm=2.5)
    assert about["architecture"] == asdict(net.architecture) and about["simulation"] == asdict(Settings())

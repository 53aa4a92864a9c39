"""Training: interrupted and resumed, ended by steps, clock or patience, and what it leaves behind."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from stress_samples import N, write_samples

from genmf_mi.core.errors import ConfigError, OutputError
from genmf_mi.core.progress import Progress
from genmf_mi.stress.fem.simulation import Settings
from genmf_mi.stress.model import layers, network, weights
from genmf_mi.stress.model.network import Architecture
from genmf_mi.stress.model.weights import WeightsError
from genmf_mi.stress.training import curves, trainer
from genmf_mi.stress.training.config import TrainConfig

TINY = Architecture(4, block_size=2, poolings=2)
CONFIG = TrainConfig(steps=6, batch=2, rate=1e-2, validate_every=3, precision="float32", device="cpu")


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_samples(tmp_path_factory.mktemp("data") / "a")


@pytest.fixture(autouse=True)
def tiny(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(network.PRESETS, "compact", TINY)
    monkeypatch.setattr(trainer, "write_curves", lambda path, log: None)  # a second each time


def train(data: Path, out: Path, config: TrainConfig, **options) -> dict:
    return trainer.train(data, out, config, cache=data.parent / "decoded", **options)


class Killed(Exception):
    pass


class Killer(Progress):
    """Kills a training at a step, and keeps what it has been shown."""

    def __init__(self, at: int = -1) -> None:
        self.at, self.current = at, ""
        self.shown: list[tuple[str, float, float, dict[str, float] | None]] = []

    def stage(self, name: str) -> None:
        self.current = name

    def advance(self, done: float, total: float, values: Mapping[str, float] | None = None) -> None:
        self.shown.append((self.current, done, total, values and dict(values)))
        if self.current == "training" and done == self.at:
            raise Killed


def test_progress(data: Path, tmp_path: Path) -> None:
    """Steps with their loss and the last validation, and the samples of each validation."""
    progress = Killer()
    result = train(data, tmp_path, CONFIG, progress=progress)
    training = [shown[1:] for shown in progress.shown if shown[0] == "training"]
    assert [(done, total) for done, total, _ in training] == [(step, 6) for step in range(1, 7)]
    assert [list(values) for *_, values in training] == 3 * [["loss"]] + 3 * [
        ["loss", "validation_mae", "validation_iou"]
    ]
    validating = [shown[1:] for shown in progress.shown if shown[0] == "validating"]
    assert validating == 2 * [(1, 2, None), (2, 2, None)]
    assert result["steps_made"] == 6


def test_resumed_training_ends_like_an_uninterrupted_one(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(trainer, "CHECKPOINT_EVERY", 2)
    whole = train(data, tmp_path / "whole", CONFIG)
    for kill_at, step in ((3, 2), (5, 4)):
        out = tmp_path / f"killed-{kill_at}"
        with pytest.raises(Killed):
            train(data, out, CONFIG, progress=Killer(kill_at))
        assert torch.load(out / trainer.CHECKPOINT, weights_only=True)["step"] == step
        torch.manual_seed(99)
        assert train(data, out, CONFIG, resume=True)["sha256"] == whole["sha256"]
        logs = [[json.loads(x) for x in (p / trainer.LOG).read_text().splitlines()] for p in (out, tmp_path / "whole")]
        for ours, theirs in zip(*logs, strict=True):
            assert {**ours, "seconds": 0} == {**theirs, "seconds": 0}


def test_what_a_training_leaves(data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trainer, "write_curves", curves.write_curves)
    result = train(data, tmp_path, replace(CONFIG, steps=16, validate_every=8, tail=1.0))
    lines = [json.loads(line) for line in (tmp_path / trainer.LOG).read_text().splitlines()]
    losses = [line["loss"] for line in lines if "loss" in line]
    rates = [line["rate"] for line in lines if "loss" in line]
    validations = [line["validation_loss"] for line in lines if "validation_loss" in line]
    assert len(losses) == 16 and len(validations) == 2
    assert np.mean(losses[-4:]) < 0.5 * np.mean(losses[:4])
    assert max(rates) <= CONFIG.rate and rates[-1] < 0.1 * CONFIG.rate and rates[0] < 0.1 * CONFIG.rate
    assert (tmp_path / trainer.CURVES).read_bytes()[1:4] == b"PNG"
    assert not (tmp_path / trainer.CHECKPOINT).exists()
    written = json.loads((tmp_path / trainer.METRICS).read_text())
    assert written == result and written["samples"] == {"train": 5, "validation": 2}
    assert written["validation"]["all"]["loss"] == min(validations)
    assert weights.digest(tmp_path / trainer.WEIGHTS) == result["sha256"]
    net, about = weights.load(tmp_path / trainer.WEIGHTS)
    assert about["simulation"]["grid"] == N and about["training"]["steps_made"] == 16
    assert net.architecture == replace(TINY, grid=N)
    assert not any(p.requires_grad for p in net.parameters())


def test_physics_of_the_data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Size, material and protocol that the network learns from are those that the samples were simulated with."""
    given, forward = [], layers.Physics.forward

    def recorded(self: layers.Physics, phi: torch.Tensor, settings: Settings) -> torch.Tensor:
        given.append(settings)
        return forward(self, phi, settings)

    monkeypatch.setitem(network.PRESETS, "compact", replace(TINY, physics=True))
    monkeypatch.setattr(layers.Physics, "forward", recorded)
    settings = Settings(grid=N, size_mm=50.0, material="petg")
    train(write_samples(tmp_path / "data", settings), tmp_path / "out", replace(CONFIG, steps=1))
    assert given and all(one == settings for one in given)


def test_starting_from_weights(data: Path, tmp_path: Path) -> None:
    first = trainer.train(data, tmp_path / "first", CONFIG)
    begin = tmp_path / "first" / trainer.WEIGHTS
    still = replace(CONFIG, start=str(begin), steps=1, rate=1e-12)
    second = trainer.train(data, tmp_path / "second", still)
    assert second["start"] == first["sha256"], "the weights say where they come from, not where they lay"
    assert second["validation"]["all"]["loss"] == pytest.approx(first["validation"]["all"]["loss"], rel=1e-3)
    with pytest.raises(WeightsError, match="does not exist"):
        trainer.train(data, tmp_path / "third", replace(still, start="none.safetensors"))


def test_minutes_end_a_training(data: Path, tmp_path: Path) -> None:
    result = train(data, tmp_path, replace(CONFIG, steps=1000, minutes=1e-6))
    assert result["steps_made"] == 1 and result["validation"]["all"]["samples"] == 2


def test_patience_ends_a_training(data: Path, tmp_path: Path) -> None:
    result = train(data, tmp_path, replace(CONFIG, steps=1000, rate=1e-12, validate_every=1, patience=2))
    assert 3 <= result["steps_made"] < 20


def test_half_the_resolution(data: Path, tmp_path: Path) -> None:
    train(data, tmp_path, replace(CONFIG, steps=1, stride=2))
    net, about = weights.load(tmp_path / trainer.WEIGHTS)
    assert net.architecture.grid == about["simulation"]["grid"] == 17


def test_a_training_is_not_lost_by_mistake(data: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    with pytest.raises(OutputError, match="no interrupted training"):
        train(data, out, CONFIG, resume=True)
    with pytest.raises(Killed):
        train(data, out, CONFIG, progress=Killer(4))
    with pytest.raises(OutputError, match="an interrupted training"):
        train(data, out, CONFIG)
    with pytest.raises(ConfigError, match="config"):
        train(data, out, replace(CONFIG, rate=1e-4), resume=True)
    other = write_samples(tmp_path / "other", Settings(grid=N, protocol=replace(Settings().protocol, ramp_s=600.0)))
    with pytest.raises(ConfigError, match="another data"):
        train(other, out, CONFIG, resume=True)
    checkpoint = out / trainer.CHECKPOINT
    checkpoint.write_bytes(checkpoint.read_bytes()[:2000])
    with pytest.raises(OutputError, match="damaged"):
        train(data, out, CONFIG, resume=True)
    train(data, out, replace(CONFIG, steps=1), force=True)
    with pytest.raises(OutputError, match="a finished training"):
        train(data, out, CONFIG)


def test_bad_data(data: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no data set"):
        train(tmp_path / "nothing", tmp_path / "out", CONFIG)
    folder = write_samples(tmp_path / "a")
    settings = json.loads((folder / "settings.json").read_text())
    (folder / "settings.json").write_text(json.dumps({**settings, "format": 1}))
    with pytest.raises(ConfigError, match="another format"):
        train(folder, tmp_path / "out", CONFIG)
    (folder / "settings.json").write_text(json.dumps(settings))
    (folder / "samples" / "000002.npz").write_bytes(b"PK\x03\x04 and no more")
    with pytest.raises(ConfigError, match=r"000002\.npz cannot be read"):
        train(folder, tmp_path / "out", CONFIG)
    for wrong in ({"steps": 0}, {"rate": 0.0}, {"tail": -1.0}, {"minutes": float("nan")}):
        with pytest.raises(ConfigError, match=next(iter(wrong))):
            replace(CONFIG, **wrong)


def test_a_loss_that_is_no_number_ends_it(data: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="lower --rate"):
        train(data, tmp_path, replace(CONFIG, rate=1e30))


def test_command(data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from genmf_mi.cli.main import main

    command = ["stress", "train", "--data", str(data), "--out", str(tmp_path / "out"), "--cache", str(tmp_path / "c")]
    assert main([*command, "--steps", "2", "--validate-every", "2", "--precision", "float32"]) == 0
    assert "2 steps; validation:" in capsys.readouterr().out
    assert main(command) == 2
    assert "a finished training" in capsys.readouterr().err

"""Training: the loss and the scores against loops, samples as they were before they were stored, resuming, weights."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

from genmf_mi.core.errors import ConfigError, OutputError
from genmf_mi.core.frame import Frame
from genmf_mi.sdf.distance import signed_distance
from genmf_mi.sdf.redistance import redistance
from genmf_mi.stress.data import codec, reader
from genmf_mi.stress.data.dataset import FORMAT
from genmf_mi.stress.data.reader import StressSamples
from genmf_mi.stress.fem.simulation import Settings
from genmf_mi.stress.fem.statistics import SURFACE_BAND_MM
from genmf_mi.stress.model import network, weights
from genmf_mi.stress.model.network import Architecture, to_stress
from genmf_mi.stress.model.weights import WeightsError
from genmf_mi.stress.training import baselines, curves, metrics, training
from genmf_mi.stress.training.config import TrainConfig
from genmf_mi.stress.training.training import Watcher

N = 33
TINY = Architecture(4, block_size=2, poolings=2)
CONFIG = TrainConfig(steps=6, batch=2, rate=1e-2, validate_every=3, precision="float32", device="cpu")


def ball(stretch: tuple[float, float, float], n: int = N) -> np.ndarray:
    mesh = trimesh.creation.icosphere(subdivisions=3)
    return signed_distance(mesh.vertices * stretch, mesh.faces, n)


def write_samples(folder: Path, simulation: Settings | None = None) -> Path:
    """Balls whose stress rises with depth and towards the base: five for training, two for validation."""
    (folder / "samples").mkdir(parents=True)
    simulation = asdict(simulation or Settings(grid=N))
    (folder / "settings.json").write_text(json.dumps({"format": FORMAT, "simulation": simulation, "seed": 0}))
    records = []
    for index in range(7):
        rng = np.random.default_rng(index)
        layers, phi = codec.pack_distance(ball(tuple(rng.uniform(0.5, 0.9, 3))))
        height = np.linspace(1, 0, N)[None, :, None]
        layers |= codec.pack_stress(0.2 + height + np.abs(phi), phi)
        record = {
            "index": index,
            "file": f"samples/{index:06d}.npz",
            "shape": f"ball-{index // 2}",
            "family": "balls" if index < 4 else "others",
            "split": "train" if index < 5 else "validation",
            "relief_mm": [1.0, 4.0] if index % 2 else None,
        }
        np.savez_compressed(folder / record["file"], meta=np.array(json.dumps(record)), **layers)
        records.append(json.dumps(record) + "\n")
    (folder / "index.jsonl").write_text("".join(records))
    return folder


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_samples(tmp_path_factory.mktemp("data") / "a")


@pytest.fixture(autouse=True)
def tiny(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(network.PRESETS, "compact", TINY)
    monkeypatch.setattr(training, "write_curves", lambda path, log: None)  # a second each time


def fields(seed: int = 0) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Predicted and true stress, and Φ, ``[1,6,5,4]``."""
    generator = torch.Generator().manual_seed(seed)
    predicted, true = torch.rand(2, 1, 6, 5, 4, generator=generator)
    return predicted, true, torch.randn(1, 6, 5, 4, generator=generator)


@pytest.mark.parametrize("tail", [0.0, 3.0])
def test_masked_loss_and_scores_against_loops(tail: float) -> None:
    predicted, true, phi = fields()
    inside = [place for place in np.ndindex(*phi.shape) if phi[place] <= 0]
    ranked = sorted(inside, key=lambda p: -float(true[p]))
    top = ranked[: max(1, round(0.05 * len(inside)))]
    assert len(top) == 3
    total = count = difference = 0.0
    for place in inside:
        weight = 1 + tail * (place in top)
        total += weight * float(predicted[place] - true[place]) ** 2
        count += weight
        difference += abs(float(predicted[place] - true[place]))
    assert float(metrics.masked_mse(predicted, true, phi, tail)) == pytest.approx(total / count, rel=1e-5)
    assert metrics.mean_absolute_error(predicted, true, phi) == pytest.approx(difference / len(inside), rel=1e-5)
    ours = set(sorted(inside, key=lambda p: -float(predicted[p]))[:3])
    assert metrics.top_iou(predicted, true, phi) == len(ours & set(top)) / len(ours | set(top))
    assert metrics.top_iou(true, true, phi) == 1.0
    near = [float(true[p]) for p in inside if phi[p] >= -0.5]
    assert metrics.band_mean(true, phi, 0.5) == pytest.approx(np.mean(near), rel=1e-5)


def test_surface_band_is_as_deep_in_millimetres_at_any_size() -> None:
    for size_mm in (50.0, 100.0):
        frame = Frame((0.0, 0.0, 0.0), 1.0, size_mm)
        assert metrics.surface_band_depth(size_mm) * frame.mm_per_unit == pytest.approx(SURFACE_BAND_MM)
    assert metrics.surface_band_depth(100.0) == pytest.approx(0.076), "what the published scores were computed with"


def test_loss_does_not_see_the_outside() -> None:
    predicted, true, phi = fields()
    predicted.requires_grad_()
    (gradient,) = torch.autograd.grad(metrics.masked_mse(predicted, true, phi, tail=1.0), predicted)
    assert (gradient[phi > 0] == 0).all() and (gradient[phi <= 0] != 0).all()


def test_summary_by_family_and_relief() -> None:
    rows = [
        {
            "index": i,
            "family": "ab"[i > 3],
            "relief": bool(i % 2),
            "loss": 0.0,
            "mae": float(i),
            "iou": 0.5,
            "mean": 1.0,
        }
        | {"band": 1 + 0.1 * (i % 2) * i, "true_band": 2 + 0.4 * (i % 2) * i}
        for i in range(8)
    ]
    table = metrics.summary(rows)
    assert table["all"]["samples"] == 8 and table["all"]["mae"] == 3.5 and table["b"]["mae"] == 5.5
    assert table["all"]["relief"] > 0.99, "the change by relief is predicted in proportion"
    assert table["a"]["relief"] is None


@pytest.mark.parametrize("stretch", [(0.9, 0.9, 0.9), (0.5, 0.95, 0.7)])
def test_distance_as_it_was_before_it_was_stored(stretch: tuple[float, float, float]) -> None:
    import igl

    mesh = trimesh.creation.icosphere(subdivisions=3)
    vertices, cell = mesh.vertices * stretch, 2 / 64
    _, stored = codec.pack_distance(signed_distance(vertices, mesh.faces, 65))
    again = redistance(stored)
    seen = stored < 4 * cell
    squared, _, _ = igl.point_mesh_squared_distance(np.argwhere(seen) * cell - 1, vertices, mesh.faces.astype(np.int64))
    before, after = (abs(abs(field[seen]) - np.sqrt(squared)) / cell for field in (stored.astype(np.float32), again))
    assert after.mean() < 0.025 < 0.05 < before.mean(), "of a cell"
    assert after.max() < 0.25
    assert ((again <= 0) == (stored <= 0)).all()
    near = abs(stored) < cell
    assert (again[near] == stored[near]).all()


def test_a_wall_thinner_than_the_band() -> None:
    plate = trimesh.creation.box((1.8, 0.1, 1.8))
    exact = signed_distance(plate.vertices, plate.faces, 65)
    again = redistance(codec.pack_distance(exact)[1])
    assert abs(again - exact)[exact < 4 * 2 / 64].max() < 0.7 * 2 / 64


def test_cache_gives_the_same_and_is_used(data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plain, cached = StressSamples(data), StressSamples(data, cache=tmp_path)
    for item in range(len(plain)):
        for ours, theirs in zip(plain[item], cached[item]):
            assert torch.equal(ours, theirs)
    (path,) = tmp_path.glob("*/000003.npy")
    monkeypatch.setattr(reader.StressSamples, "_decoded", lambda self, item: pytest.fail("decoded again"))
    cached[3]
    monkeypatch.undo()
    path.write_bytes(path.read_bytes()[:1000])
    assert torch.equal(cached[3][1], plain[3][1]), "a damaged file is made again"
    other = write_samples(tmp_path / "other", Settings(grid=N, edge_mm=2.0))
    assert StressSamples(other, cache=tmp_path).cache != cached.cache


def test_baselines(data: Path) -> None:
    samples = StressSamples(data)
    mean = float(torch.cat([stress[phi <= 0] for phi, stress in samples]).mean())
    phi, _ = samples[0]
    assert float(baselines.constant(samples)(phi).mean()) == pytest.approx(mean, rel=1e-5)
    rows = [metrics.score(p, samples) for p in (baselines.constant(samples), baselines.pointwise(samples))]
    errors = [metrics.summary(r)["all"]["mae"] for r in rows]
    assert errors[1] < 0.3 * errors[0], "depth and height are what this field is made of"


def test_local_thickness() -> None:
    """A slab of 13 samples is 6 cells thick from the middle to either side, wherever one asks."""
    depth = 6.0 - np.abs(np.arange(-8, 9.0))
    depth = np.broadcast_to(depth[:, None, None], (17, 9, 9))
    inside = depth >= 0
    assert np.allclose(baselines.thickness(depth)[inside], 6.0)


def train(data: Path, out: Path, config: TrainConfig, **options) -> dict:
    return training.train(data, out, config, cache=data.parent / "decoded", **options)


class Killed(Exception):
    pass


class Killer(Watcher):
    def __init__(self, at: int) -> None:
        self.at = at

    def step(self, step: int, done: float, loss: float) -> None:
        if step == self.at:
            raise Killed


def test_resumed_training_ends_like_an_uninterrupted_one(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(training, "CHECKPOINT_EVERY", 2)
    whole = train(data, tmp_path / "whole", CONFIG)
    for kill_at, step in ((3, 2), (5, 4)):
        out = tmp_path / f"killed-{kill_at}"
        with pytest.raises(Killed):
            train(data, out, CONFIG, watcher=Killer(kill_at))
        assert torch.load(out / training.CHECKPOINT, weights_only=True)["step"] == step
        torch.manual_seed(99)
        assert train(data, out, CONFIG, resume=True)["sha256"] == whole["sha256"]
        logs = [[json.loads(x) for x in (p / training.LOG).read_text().splitlines()] for p in (out, tmp_path / "whole")]
        for ours, theirs in zip(*logs, strict=True):
            assert {**ours, "seconds": 0} == {**theirs, "seconds": 0}


def test_what_a_training_leaves(data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(training, "write_curves", curves.write_curves)
    result = train(data, tmp_path, replace(CONFIG, steps=16, validate_every=8, tail=1.0))
    lines = [json.loads(line) for line in (tmp_path / training.LOG).read_text().splitlines()]
    losses = [line["loss"] for line in lines if "loss" in line]
    rates = [line["rate"] for line in lines if "loss" in line]
    validations = [line["validation_loss"] for line in lines if "validation_loss" in line]
    assert len(losses) == 16 and len(validations) == 2
    assert np.mean(losses[-4:]) < 0.5 * np.mean(losses[:4])
    assert max(rates) <= CONFIG.rate and rates[-1] < 0.1 * CONFIG.rate and rates[0] < 0.1 * CONFIG.rate
    assert (tmp_path / training.CURVES).read_bytes()[1:4] == b"PNG"
    assert not (tmp_path / training.CHECKPOINT).exists()
    written = json.loads((tmp_path / training.METRICS).read_text())
    assert written == result and written["samples"] == {"train": 5, "validation": 2}
    assert written["validation"]["all"]["loss"] == min(validations)
    net, about = weights.load(tmp_path / training.WEIGHTS, sha256=result["sha256"])
    assert about["simulation"]["grid"] == N and about["training"]["steps_made"] == 16
    assert net.architecture == replace(TINY, grid=N)
    assert not any(p.requires_grad for p in net.parameters())


def test_starting_from_weights(data: Path, tmp_path: Path) -> None:
    first = training.train(data, tmp_path / "first", CONFIG)
    begin = tmp_path / "first" / training.WEIGHTS
    still = replace(CONFIG, start=str(begin), steps=1, rate=1e-12)
    second = training.train(data, tmp_path / "second", still)
    assert second["start"] == first["sha256"], "the weights say where they come from, not where they lay"
    assert second["validation"]["all"]["loss"] == pytest.approx(first["validation"]["all"]["loss"], rel=1e-3)
    with pytest.raises(WeightsError, match="does not exist"):
        training.train(data, tmp_path / "third", replace(still, start="none.safetensors"))


def test_minutes_end_a_training(data: Path, tmp_path: Path) -> None:
    result = train(data, tmp_path, replace(CONFIG, steps=1000, minutes=1e-6))
    assert result["steps_made"] == 1 and result["validation"]["all"]["samples"] == 2


def test_patience_ends_a_training(data: Path, tmp_path: Path) -> None:
    result = train(data, tmp_path, replace(CONFIG, steps=1000, rate=1e-12, validate_every=1, patience=2))
    assert 3 <= result["steps_made"] < 20


def test_half_the_resolution(data: Path, tmp_path: Path) -> None:
    train(data, tmp_path, replace(CONFIG, steps=1, stride=2))
    net, about = weights.load(tmp_path / training.WEIGHTS)
    assert net.architecture.grid == about["simulation"]["grid"] == 17


def test_a_training_is_not_lost_by_mistake(data: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    with pytest.raises(OutputError, match="no interrupted training"):
        train(data, out, CONFIG, resume=True)
    with pytest.raises(Killed):
        train(data, out, CONFIG, watcher=Killer(4))
    with pytest.raises(OutputError, match="an interrupted training"):
        train(data, out, CONFIG)
    with pytest.raises(ConfigError, match="config"):
        train(data, out, replace(CONFIG, rate=1e-4), resume=True)
    other = write_samples(tmp_path / "other", Settings(grid=N, protocol=replace(Settings().protocol, ramp_s=600.0)))
    with pytest.raises(ConfigError, match="another data"):
        train(other, out, CONFIG, resume=True)
    checkpoint = out / training.CHECKPOINT
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


@pytest.fixture
def saved(tmp_path: Path) -> tuple[Path, str]:
    torch.manual_seed(0)
    net = network.network("compact", N)
    path = tmp_path / "weights.safetensors"
    return path, weights.save(path, net, "compact", asdict(Settings(grid=N)), {"steps_made": 1})


def test_weights_come_back(saved: tuple[Path, str]) -> None:
    from safetensors.numpy import load_file

    path, digest = saved
    torch.manual_seed(0)
    net = network.network("compact", N)
    again, about = weights.load(path, preset="compact", simulation=asdict(Settings(grid=N, edge_mm=1.2)), sha256=digest)
    assert about["preset"] == "compact" and about["training"] == {"steps_made": 1}
    phi = torch.from_numpy(ball((0.6, 0.9, 0.7)))[None, None]
    with torch.no_grad():
        assert torch.allclose(net(phi), again(phi), atol=0.01)
    raw = load_file(path)
    assert raw.keys() == net.state_dict().keys() and {x.dtype for x in raw.values()} == {np.dtype("float16")}


def test_bad_weights(saved: tuple[Path, str], tmp_path: Path) -> None:
    path, digest = saved
    with pytest.raises(WeightsError, match="does not exist"):
        weights.load(tmp_path / "none.safetensors")
    with pytest.raises(WeightsError, match="SHA-256"):
        weights.load(path, sha256="0" * 64)
    with pytest.raises(WeightsError, match="not 'paper'"):
        weights.load(path, preset="paper", sha256=digest)
    hot = asdict(Settings(grid=N, protocol=replace(Settings().protocol, heat_transfer_coefficient_w_m2k=10.0)))
    with pytest.raises(WeightsError, match="heat_transfer_coefficient_w_m2k"):
        weights.load(path, simulation=hot)
    with pytest.raises(WeightsError, match="material"):
        weights.load(path, simulation=asdict(Settings(grid=N, material="abs")))
    whole = path.read_bytes()
    for damaged in (whole[:-100], whole[:50], b"", b"not at all"):
        path.write_bytes(damaged)
        with pytest.raises(WeightsError, match="damaged"):
            weights.load(path)
    from safetensors.torch import save_file

    save_file({"a": torch.zeros(1)}, path)
    with pytest.raises(WeightsError, match="no stress network"):
        weights.load(path)


def test_weights_that_do_not_fit_their_description(saved: tuple[Path, str]) -> None:
    from safetensors import safe_open
    from safetensors.torch import load_file, save_file

    path, _ = saved
    with safe_open(path, framework="pt") as file:
        header = file.metadata()
    tensors = load_file(path)
    tensors.pop("fusion.out.bias")
    save_file(tensors, path, header)
    with pytest.raises(WeightsError, match="does not fit"):
        weights.load(path)


def test_command(data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from genmf_mi.cli.main import main

    command = ["stress", "train", "--data", str(data), "--out", str(tmp_path / "out"), "--cache", str(tmp_path / "c")]
    assert main([*command, "--steps", "2", "--validate-every", "2", "--precision", "float32"]) == 0
    assert "2 steps; validation:" in capsys.readouterr().out
    assert main(command) == 2
    assert "a finished training" in capsys.readouterr().err


def test_stress_of_a_prediction_is_not_negative(data: Path) -> None:
    from genmf_mi.stress.model import compute

    torch.manual_seed(3)
    net = network.network("compact", N)
    phi, _ = StressSamples(data)[0]
    field = compute.stress(net, phi, bfloat16=False)
    assert (field >= 0).all() and field.shape == phi.shape
    inner = to_stress(net(phi[None]))[0]
    assert inner.shape == phi.shape

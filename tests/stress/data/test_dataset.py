"""Samples are complete, repeatable, split by shape, and survive kills and crashes."""

from __future__ import annotations

import json
import multiprocessing
import os
import resource
import signal
import threading
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
import trimesh

from genmf_mi.core.errors import ConfigError, OutputError
from genmf_mi.core.progress import Progress
from genmf_mi.sdf.distance import axis, signed_distance
from genmf_mi.stress.data import codec, dataset
from genmf_mi.stress.data.dataset import DatasetSettings, build, chosen, read_index
from genmf_mi.stress.data.reader import StressSamples, apply_symmetry
from genmf_mi.stress.data.recipe import recipe_of, surface_of
from genmf_mi.stress.data.shapes import FAMILIES
from genmf_mi.stress.fem.simulation import Settings

COARSE = Settings(grid=33, edge_mm=9.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six samples with two workers."""
    out = tmp_path_factory.mktemp("samples")
    tally = build(out, 6, DatasetSettings(COARSE, seed=1), workers=2)
    assert tally.added == 6
    return out


class Shown(Progress):
    """Keeps what it is shown."""

    def __init__(self) -> None:
        self.shown: list[tuple[float, float]] = []
        self.warnings: list[str] = []

    def advance(self, done: float, total: float, values: Mapping[str, float] | None = None) -> None:
        self.shown.append((done, total))

    def warn(self, message: str) -> None:
        self.warnings.append(message)


def test_index_is_complete(folder: Path) -> None:
    records = read_index(folder)
    assert sorted(r["index"] for r in records) == list(range(6))
    for record in records:
        if "error" not in record:
            assert (folder / record["file"]).exists()
            assert record["von_mises_mpa"]["mean"] > 0


def test_resuming_adds_only_what_is_missing(folder: Path) -> None:
    lines = (folder / "index.jsonl").read_text().splitlines(keepends=True)
    before = {r["index"]: r for r in read_index(folder)}
    # A kill while a line was written, and a sample whose line was lost.
    (folder / "index.jsonl").write_text("".join(lines[:4]) + lines[4][:20])
    missing = {json.loads(line)["index"] for line in lines[4:]}
    progress = Shown()
    tally = build(folder, 6, DatasetSettings(COARSE, seed=1), workers=1, progress=progress)
    assert tally.added == len(missing) == 2
    assert progress.shown == [(4, 6), (5, 6), (6, 6)]
    assert len(progress.warnings) == sum("error" in before[index] for index in missing)
    after = {r["index"]: r for r in read_index(folder)}
    assert after.keys() == before.keys()
    for index in missing:
        assert after[index].get("von_mises_mpa") == before[index].get("von_mises_mpa"), "the same seed, the same sample"


def test_settings_are_not_mixed(folder: Path) -> None:
    with pytest.raises(ConfigError, match="simulation"):
        build(folder, 7, DatasetSettings(Settings(grid=33, edge_mm=8.0), seed=1))
    with pytest.raises(ConfigError, match="seed"):
        build(folder, 7, DatasetSettings(COARSE, seed=2))


def test_a_worker_that_dies_costs_one_sample(tmp_path: Path) -> None:
    """The first worker kills itself, as the kernel does when memory runs out; the run goes on and records the cause."""
    others = set(multiprocessing.active_children())
    (tmp_path / "samples").mkdir()
    run = dataset._run(iter(range(3)), tmp_path, DatasetSettings(COARSE, seed=1), workers=1)

    def kill() -> None:
        while not (workers := set(multiprocessing.active_children()) - others):
            pass
        os.kill(workers.pop().pid, signal.SIGKILL)

    thread = threading.Thread(target=kill)
    thread.start()
    records = list(run)
    thread.join()
    assert records[0] == {"index": 0, "error": "the worker died with exit code -9"}
    assert [r["index"] for r in records] == [0, 1, 2]


def test_a_full_disk_stops_the_run_and_loses_nothing(tmp_path: Path) -> None:
    """No file may grow beyond 2 kB, in the workers neither: room for the settings but for no sample."""
    settings = DatasetSettings(COARSE, seed=1)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2048, hard))
    try:
        with pytest.raises(OutputError, match="cannot write"):
            build(tmp_path, 1, settings)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert read_index(tmp_path) == [] and list((tmp_path / "samples").iterdir()) == []
    assert build(tmp_path, 1, settings).added == 1


def test_failures_are_recorded_and_retried(tmp_path: Path) -> None:
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "broken.ply").write_text("ply\n")
    sources = dataset.meshes_in([tmp_path / "meshes"])
    index = next(i for i in range(100) if recipe_of(i, 3, sources, {}).path is not None)
    settings = DatasetSettings(COARSE, 3, sources)
    (tmp_path / "out" / "samples").mkdir(parents=True)
    (record,) = dataset._run(iter([index]), tmp_path / "out", settings, 1)
    assert record["index"] == index and "broken.ply" in record["error"]


def test_a_folder_is_claimed(tmp_path: Path) -> None:
    with dataset._locked(tmp_path), pytest.raises(ConfigError, match="another process"), dataset._locked(tmp_path):
        pass
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot write"), dataset._locked(tmp_path / "file"):
        pass


def test_split_is_by_shape_and_fixed() -> None:
    pairs = [(recipe_of(2 * k, 0, {}, {}), recipe_of(2 * k + 1, 0, {}, {})) for k in range(300)]
    assert all(a.shape == b.shape and a.split == b.split for a, b in pairs)
    assert all(a.relief is None and 0.3 <= b.relief[0] <= 1.5 and 2 <= b.relief[1] <= 8 for a, b in pairs)
    share = np.mean([a.split == "train" for a, _ in pairs])
    assert 0.72 < share < 0.88
    sources = {"spot": Path("a"), "spotcow": Path("b")}
    both = {r.path: r.split for r in (recipe_of(i, 0, sources, {"spotcow": "spot"}) for i in range(200)) if r.path}
    assert both[Path("a")] == both[Path("b")]


def test_splits_can_be_made_alone(tmp_path: Path) -> None:
    settings = DatasetSettings(COARSE, seed=1)
    parts = [chosen(60, settings, [split]) for split in ("train", "validation", "test")]
    assert sorted(index for part in parts for index in part) == chosen(60, settings) == list(range(60)) and all(parts)
    first = parts[2][:1]
    assert build(tmp_path, first[0] + 1, settings, splits=["test"]).added == 1
    assert [r["index"] for r in read_index(tmp_path)] == first


@pytest.mark.parametrize("family", sorted(FAMILIES))
def test_families_give_closed_bodies(family: str) -> None:
    index = next(i for i in range(0, 400, 2) if recipe_of(i, 5, {}, {}).family == family)
    for what in (recipe_of(index, 5, {}, {}), recipe_of(index + 1, 5, {}, {})):
        vertices, faces = surface_of(what, 5, 100.0, 65)
        mesh = trimesh.Trimesh(vertices, faces, process=False)
        assert mesh.is_watertight and mesh.volume > 0
        assert np.ptp(vertices, axis=0).max() == pytest.approx(1.9)


def test_packing_keeps_what_it_promises() -> None:
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.9)
    exact = signed_distance(ball.vertices * [1, 0.6, 0.8], ball.faces, 65)
    layers, phi = codec.pack_distance(exact)
    assert (codec.unpack_distance(layers, 65) == phi).all()
    near = abs(exact) < 2 * 2 / 64
    assert abs(phi - exact)[near].max() <= codec.NEAR_STEP / 2 + 2e-4
    assert abs(phi - exact).max() <= codec.FAR_STEP / 2 + 5e-4

    x, y, z = np.meshgrid(axis(65), axis(65), axis(65), indexing="ij")
    stress = np.exp(3 * x) * (1.01 + np.sin(5 * y)) + z**2
    back = codec.unpack_stress(codec.pack_stress(stress, phi), phi)
    assert (back[phi > 0] == 0).all()
    assert (abs(back - stress) / (stress + codec.CODEC_SCALE_MPA))[phi <= 0].max() < 0.006


def test_reading_back(folder: Path) -> None:
    import torch

    splits = {r["split"] for r in read_index(folder) if "error" not in r}
    split = sorted(splits)[0]
    samples = StressSamples(folder, split)
    phi, stress = samples[0]
    assert phi.shape == stress.shape == (1, 33, 33, 33) and phi.dtype == torch.float32
    assert (stress[phi > 0] == 0).all() and (stress[phi <= 0] > 0).float().mean() > 0.9
    record = samples.records[0]
    assert stress[phi <= 0].mean().item() == pytest.approx(record["von_mises_mpa"]["mean"], rel=0.15)
    assert StressSamples(folder, split, stride=2)[0][0].shape == (1, 17, 17, 17)
    with pytest.raises(ConfigError, match="split"):
        StressSamples(folder, "all")


def test_eight_different_symmetries_keep_the_vertical() -> None:
    field = np.random.default_rng(0).random((5, 5, 5))
    images = [apply_symmetry(field, s) for s in range(8)]
    assert len({image.tobytes() for image in images}) == 8
    for image in images:
        assert np.allclose(image.mean(axis=(0, 2)), field.mean(axis=(0, 2)))

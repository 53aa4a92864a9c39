"""Samples as they were before they were stored, and the cache of decoded ones."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from stress_samples import N, write_samples

from genmf_mi.sdf.distance import signed_distance
from genmf_mi.sdf.redistance import redistance
from genmf_mi.stress.data import codec, reader
from genmf_mi.stress.data.dataset import DatasetSettings, build
from genmf_mi.stress.data.reader import StressSamples
from genmf_mi.stress.fem.simulation import Settings


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_samples(tmp_path_factory.mktemp("data") / "a")


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


def test_samples_of_former_names_can_be_read_and_added_to(tmp_path: Path) -> None:
    """Data sets say ``film_w_m2k`` that were made before the heat transfer coefficient had its name."""
    settings = DatasetSettings(Settings(grid=N))
    folder = write_samples(tmp_path / "a")
    record = json.loads(json.dumps(settings.record()))
    record["simulation"]["protocol"]["film_w_m2k"] = record["simulation"]["protocol"].pop(
        "heat_transfer_coefficient_w_m2k"
    )
    (folder / "settings.json").write_text(json.dumps(record))
    assert StressSamples(folder).simulation == Settings(grid=N)
    assert build(folder, 7, settings).added == 0

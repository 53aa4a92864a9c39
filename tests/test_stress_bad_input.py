"""Bad input ends in one clear sentence and exit code 2, and leaves no half results."""

from __future__ import annotations

import errno
import json
import os
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp
import trimesh

from genmf_mi.cli import main as cli
from genmf_mi.cli import stress as commands
from genmf_mi.core.errors import AssetError, ConfigError, OutputError, SolidError
from genmf_mi.stress.fem import elasticity
from genmf_mi.stress.fem import simulation as fem
from genmf_mi.stress.fem.linear import SolveError, solve_spd
from genmf_mi.stress.fem.materials import Material, material
from genmf_mi.stress.fem.protocol import Protocol
from genmf_mi.stress.report import output

COARSE = {"edge_mm": 8.0, "grid": 33, "picture": False}


@pytest.fixture
def block(tmp_path: Path) -> Path:
    path = tmp_path / "block.ply"
    trimesh.creation.box((1.0, 0.6, 0.4)).export(path)
    return path


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"poisson_ratio": 0.5}, "poisson_ratio"),
        ({"youngs_modulus_mpa": -1.0}, "youngs_modulus_mpa"),
        ({"expansion_per_k": float("nan")}, "expansion_per_k"),
        ({"density_kg_m3": 0.0}, "density_kg_m3"),
    ],
)
def test_impossible_materials(change: dict, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        Material(**{**vars(material("pla")), **change})


def test_impossible_settings() -> None:
    for change in ({"ambient_end_celsius": float("nan")}, {"step_s": 0.0}, {"record_s": 90.0}, {"ramp_s": -1.0}):
        with pytest.raises(ConfigError):
            Protocol(**change)
    for change in ({"size_mm": 0.0}, {"edge_mm": float("nan")}, {"grid": 5}, {"material": "wood"}):
        with pytest.raises(ConfigError):
            fem.Settings(**change)


def test_bad_surfaces(tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(subdivisions=1)
    with pytest.raises(SolidError, match="not numbers"):
        fem.simulate(np.where(ball.vertices > 0.9, np.nan, ball.vertices), ball.faces)
    with pytest.raises(SolidError, match="no vertices"):
        fem.simulate(np.zeros((0, 3)), np.zeros((0, 3), dtype=int))
    with pytest.raises(SolidError, match="one place"):
        fem.simulate(np.zeros((3, 3)), np.array([[0, 1, 2]]))
    with pytest.raises(SolidError, match="thinner than"):
        fem.simulate(ball.vertices * [1, 1e-9, 1], ball.faces, fem.Settings(grid=33))
    with pytest.raises(AssetError, match="does not exist"):
        commands.simulate(tmp_path / "missing.glb", out=tmp_path / "out", **COARSE)


def test_a_solve_that_does_not_converge_gives_no_field() -> None:
    matrix = sp.diags([1.0, 1e-9, -1.0]).tocsr()
    with pytest.raises(SolveError, match="did not converge"):
        solve_spd(matrix, np.ones(3), None, 1e-9, max_iterations=20)


def exported(path: Path, vertices, faces) -> Path:
    trimesh.Trimesh(vertices, faces, process=False).export(path)
    return path


def test_thin_parts_are_warned_about(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    """On a grid of 33, two cells are 6.6 mm."""
    plate = trimesh.creation.box((1.0, 0.04, 1.0))
    settings = {**COARSE, "edge_mm": 3.5, "out": tmp_path / "out"}
    commands.simulate(exported(tmp_path / "plate.ply", plate.vertices, plate.faces), **settings)
    fraction = json.loads((tmp_path / "out" / "stress.json").read_text(encoding="utf-8"))["mesh"]["thin_fraction"]
    assert fraction > 0.8
    said = " ".join(capsys.readouterr().out.split())
    assert f"plate.ply is thinner than two grid cells under {fraction:.0%} of its surface" in said


BALL = trimesh.creation.icosphere(subdivisions=2)
BAD_SHAPES = {
    "sheet": ([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]], [[0, 1, 2], [0, 2, 3]]),
    "empty": (np.zeros((0, 3)), np.zeros((0, 3), dtype=int)),
    "nan": (np.where(BALL.vertices > 0.9, np.nan, BALL.vertices), BALL.faces),
    "flat": (BALL.vertices * [1, 0, 1], BALL.faces),
}


@pytest.mark.parametrize("name", sorted(BAD_SHAPES))
def test_a_bad_shape_ends_the_command(name: str, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    """Exit code 2, one sentence with the reason, and no result."""
    path = exported(tmp_path / f"{name}.ply", *BAD_SHAPES[name])
    out = tmp_path / "out"
    assert cli.main(["stress", "simulate", str(path), "--out", str(out), "--edge-mm", "8", "--grid", "33"]) == 2
    assert capsys.readouterr().err.startswith("error: ")
    assert not out.exists() or not list(out.iterdir())


@pytest.mark.parametrize(
    "arguments",
    [
        ["--material", "wood"],
        ["--edge-mm", "0"],
        ["--protocol.ambient-end-celsius", "nan"],
        ["--protocol.heat-transfer-coefficient-w-m2k", "-5"],
    ],
)
def test_a_bad_setting_ends_the_command(
    arguments: list[str], block: Path, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    assert cli.main(["stress", "simulate", str(block), "--out", str(tmp_path / "out"), *arguments]) == 2
    assert capsys.readouterr().err.startswith("error: ")


def test_a_failed_solve_ends_the_command(
    block: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    monkeypatch.setattr(elasticity, "TOLERANCE", 1e-30)
    out = tmp_path / "out"
    assert cli.main(["stress", "simulate", str(block), "--out", str(out), "--edge-mm", "12", "--grid", "33"]) == 2
    assert "the elastic equilibrium did not converge" in capsys.readouterr().err
    assert list(out.iterdir()) == []


def test_full_disk_leaves_no_half_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    field = fem.simulate(BALL.vertices, BALL.faces, fem.Settings(edge_mm=16.0, grid=33)).field

    def full(*_) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(OutputError, match="No space left"):
        output.write_vtu(tmp_path / "stress.vtu", field)
    assert list(tmp_path.iterdir()) == []

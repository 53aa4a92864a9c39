"""Bad input to simulations ends in one clear sentence, and leaves no half results."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp
import trimesh

from genmf_mi.core.errors import ConfigError, OutputError, SolidError
from genmf_mi.stress.fem import simulation as fem
from genmf_mi.stress.fem.linear import SolveError, solve_spd
from genmf_mi.stress.fem.materials import Material, material
from genmf_mi.stress.fem.protocol import Protocol
from genmf_mi.stress.report import output

BALL = trimesh.creation.icosphere(subdivisions=2)


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


def test_bad_surfaces() -> None:
    ball = trimesh.creation.icosphere(subdivisions=1)
    with pytest.raises(SolidError, match="not numbers"):
        fem.simulate(np.where(ball.vertices > 0.9, np.nan, ball.vertices), ball.faces)
    with pytest.raises(SolidError, match="no vertices"):
        fem.simulate(np.zeros((0, 3)), np.zeros((0, 3), dtype=int))
    with pytest.raises(SolidError, match="one place"):
        fem.simulate(np.zeros((3, 3)), np.array([[0, 1, 2]]))
    with pytest.raises(SolidError, match="thinner than"):
        fem.simulate(ball.vertices * [1, 1e-9, 1], ball.faces, fem.Settings(grid=33))


def test_a_solve_that_does_not_converge_gives_no_field() -> None:
    matrix = sp.diags([1.0, 1e-9, -1.0]).tocsr()
    with pytest.raises(SolveError, match="did not converge"):
        solve_spd(matrix, np.ones(3), None, 1e-9, max_iterations=20)


def test_full_disk_leaves_no_half_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    field = fem.simulate(BALL.vertices, BALL.faces, fem.Settings(edge_mm=16.0, grid=33)).field

    def full(*_) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(OutputError, match="No space left"):
        output.write_vtu(tmp_path / "stress.vtu", field)
    assert list(tmp_path.iterdir()) == []

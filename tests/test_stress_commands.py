"""The commands write what they say, and bad input ends in one clear sentence."""

from __future__ import annotations

import errno
import json
import os
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp
import trimesh

from genmf_mi.errors import AssetError, ConfigError, OutputError, SolidError
from genmf_mi.frame import Frame
from genmf_mi.stress import commands, fem, output, picture
from genmf_mi.stress.grid import to_grid
from genmf_mi.stress.linear import SolveError, solve_spd
from genmf_mi.stress.materials import MATERIALS, Material, material
from genmf_mi.stress.protocol import Protocol
from genmf_mi.stress.statistics import summary, weighted_percentiles

COARSE = {"edge_mm": 8.0, "grid": 33, "picture": False}


@pytest.fixture
def block(tmp_path: Path) -> Path:
    """A block of 100 × 60 × 40 in units of its own, y up."""
    path = tmp_path / "block.ply"
    trimesh.creation.box((1.0, 0.6, 0.4)).export(path)
    return path


@pytest.fixture(scope="module")
def simulation() -> fem.Simulation:
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=3.0)
    return fem.simulate(mesh.vertices * [1, 0.7, 0.8], mesh.faces, fem.Settings(edge_mm=8.0, grid=33))


def test_simulate_writes_its_files(block: Path, tmp_path: Path) -> None:
    import meshio

    out = tmp_path / "out"
    commands.simulate(block, out=out, **COARSE)
    numbers = json.loads((out / "stress.json").read_text())
    assert 0.05 < numbers["von_mises_mpa"]["mean"] < numbers["von_mises_mpa"]["p99_9"] < 20
    mesh = meshio.read(out / "stress.vtu")
    extent = np.ptp(mesh.points, axis=0)
    assert extent == pytest.approx([100, 40, 60], rel=0.02), "millimetres, z up"
    assert mesh.points[:, 2].min() == pytest.approx(0.0, abs=1e-9)
    assert set(mesh.point_data) == {"temperature_C", "displacement_mm", "von_mises_MPa"}
    tensor = mesh.cell_data["stress_MPa"][0].reshape(-1, 3, 3)
    deviator = tensor - np.trace(tensor, axis1=1, axis2=2)[:, None, None] / 3 * np.eye(3)
    expected = np.sqrt(1.5 * (deviator**2).sum(axis=(1, 2)))
    assert np.allclose(mesh.cell_data["von_mises_cell_MPa"][0], expected, rtol=1e-4)
    with np.load(out / "stress.npz") as grid:
        assert grid["phi"].shape == grid["von_mises_mpa"].shape == (33, 33, 33)
        assert (grid["von_mises_mpa"][grid["phi"] > 0] == 0).all()
    with pytest.raises(OutputError, match="--force"):
        commands.simulate(block, out=out, **COARSE)


def test_a_volume_mesh_gives_the_same(block: Path, tmp_path: Path) -> None:
    commands.simulate(block, out=tmp_path / "a", **COARSE)
    numbers = json.loads((tmp_path / "a" / "stress.json").read_text())
    # The file is z up, while input is y up: turn it back.
    import meshio

    mesh = meshio.read(tmp_path / "a" / "stress.vtu")
    turned = mesh.points[:, [0, 2, 1]] * [1, 1, -1]
    meshio.Mesh(turned, mesh.cells).write(tmp_path / "block.vtu")
    commands.simulate(tmp_path / "block.vtu", out=tmp_path / "b", **COARSE)
    again = json.loads((tmp_path / "b" / "stress.json").read_text())
    assert again["von_mises_mpa"]["mean"] == pytest.approx(numbers["von_mises_mpa"]["mean"], rel=0.01)


def test_compare(block: Path, tmp_path: Path) -> None:
    larger = tmp_path / "larger.ply"
    trimesh.creation.box((1.05, 0.6, 0.4)).export(larger)
    settings = {**COARSE, "out": tmp_path / "out"}
    commands.compare(block, larger, **settings)
    numbers = json.loads((tmp_path / "out" / "compare.json").read_text())
    assert numbers["b"]["settings"]["size_mm"] == pytest.approx(105.0), "the same units, so the same scale"
    means = [numbers[k]["von_mises_mpa"]["mean"] for k in "ab"]
    assert numbers["ratio"]["mean"] == pytest.approx(means[1] / means[0])


def test_stress_follows_the_material(simulation: fem.Simulation) -> None:
    """σ is proportional to E; with less expansion there is less of it."""
    mesh, protocol = simulation.field.mesh, simulation.settings.protocol
    pla = material("pla")
    stiff = Material(**{**vars(pla), "youngs_modulus_mpa": 2 * pla.youngs_modulus_mpa})
    found = fem.solve(mesh, stiff, protocol)
    assert np.allclose(found.von_mises, 2 * simulation.field.von_mises, rtol=1e-3, atol=1e-5)
    assert set(MATERIALS) == {"pla", "petg", "abs", "resin"}


def test_the_sphere_cools_between_the_bounds(simulation: fem.Simulation) -> None:
    temperature = simulation.field.temperature
    assert 25.0 < temperature.min() < temperature.max() < 60.0
    numbers = summary(simulation)
    assert numbers["mesh"]["dropped_bodies"] == 0 and numbers["mesh"]["thin_fraction"] == 0.0
    assert 0.0 < numbers["surface_band"]["volume_fraction"] < 1.0


def test_grid_reproduces_a_linear_field(simulation: fem.Simulation) -> None:
    mesh, phi = simulation.mesh, simulation.phi
    field, filled = to_grid(mesh, mesh.points @ [1.0, -2.0, 3.0], phi)
    ticks = np.linspace(-1, 1, 33)
    x, y, z = np.meshgrid(ticks, ticks, ticks, indexing="ij")
    wrong = abs(field - (x - 2 * y + 3 * z))[phi <= 0] > 1e-5
    assert wrong.sum() <= filled < 0.1 * (phi <= 0).sum()
    assert (field[phi > 0] == 0).all()


def test_weighted_percentiles() -> None:
    assert weighted_percentiles(np.array([3.0, 1.0, 2.0]), np.array([1.0, 1.0, 2.0]), (25.0, 75.0, 100.0)) == [1, 2, 3]


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
        solve_spd(matrix, np.ones(3), None, 1e-9, most=20)


def test_full_disk_leaves_no_half_file(
    simulation: fem.Simulation, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(OutputError, match="No space left"):
        output.write_vtu(tmp_path / "stress.vtu", simulation.field)
    assert list(tmp_path.iterdir()) == []


def test_picture_shows_the_part_in_colour(simulation: fem.Simulation, tmp_path: Path) -> None:
    from PIL import Image

    path = tmp_path / "stress.png"
    picture.write_picture(path, [("a ball", simulation)], "ball", pixels=80)
    image = np.asarray(Image.open(path).convert("RGB")).astype(float)
    colourful = np.ptp(image, axis=2) > 60
    assert 0.05 < colourful.mean() < 0.6


def test_print_frame_is_upright() -> None:
    """What is up (y) in the asset is up (z) in the field."""
    frame = Frame.of(np.array([[0, 0, 0], [1, 2, 1.0]]), 100.0)
    top = frame.to_print(np.array([[0, 0.95, 0], [0, -0.95, 0]]))
    assert top[0, 2] - top[1, 2] == pytest.approx(100.0)

"""``genmf-mi stress``: the files that the commands write, what they print, and how they refuse."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

from genmf_mi.cli import main as cli
from genmf_mi.cli.stress.compare import compare
from genmf_mi.cli.stress.simulate import simulate
from genmf_mi.core.errors import AssetError, OutputError, SolidError
from genmf_mi.stress.data import dataset as data
from genmf_mi.stress.fem import elasticity
from genmf_mi.stress.fem.protocol import Protocol
from genmf_mi.stress.fem.settings import Settings
from genmf_mi.stress.model import predictor
from genmf_mi.stress.report import output, picture
from genmf_mi.stress.training import trainer
from genmf_mi.stress.training.config import TrainConfig

pytestmark = pytest.mark.usefixtures("coarse_warpage")

COARSE = {"edge_mm": 8.0, "grid": 33, "picture": False}


@pytest.fixture
def block(tmp_path: Path) -> Path:
    """A block of 100 × 60 × 40 in units of its own, y up."""
    path = tmp_path / "block.ply"
    trimesh.creation.box((1.0, 0.6, 0.4)).export(path)
    return path


def test_simulate_writes_its_files(block: Path, tmp_path: Path) -> None:
    import meshio

    out = tmp_path / "out"
    simulate(block, out=out, **COARSE)
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
        simulate(block, out=out, **COARSE)


def test_a_volume_mesh_gives_the_same(block: Path, tmp_path: Path) -> None:
    simulate(block, out=tmp_path / "a", **COARSE)
    numbers = json.loads((tmp_path / "a" / "stress.json").read_text())
    # The file is z up, while input is y up: turn it back.
    import meshio

    mesh = meshio.read(tmp_path / "a" / "stress.vtu")
    turned = mesh.points[:, [0, 2, 1]] * [1, 1, -1]
    meshio.Mesh(turned, mesh.cells).write(tmp_path / "block.vtu")
    simulate(tmp_path / "block.vtu", out=tmp_path / "b", **COARSE)
    again = json.loads((tmp_path / "b" / "stress.json").read_text())
    assert again["von_mises_mpa"]["mean"] == pytest.approx(numbers["von_mises_mpa"]["mean"], rel=0.01)


def test_compare(block: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from PIL import Image

    monkeypatch.setattr(picture, "write_picture", partial(picture.write_picture, pixels=40))
    larger = tmp_path / "larger.ply"
    trimesh.creation.box((1.05, 0.6, 0.4)).export(larger)
    settings = {**COARSE, "out": tmp_path / "out", "picture": True}
    compare(block, larger, **settings)
    with Image.open(tmp_path / "out" / "compare.png") as sheet:
        assert sheet.height > 0.8 * sheet.width, "two rows"
    numbers = json.loads((tmp_path / "out" / "compare.json").read_text())
    assert numbers["b"]["settings"]["size_mm"] == pytest.approx(105.0), "the same units, so the same scale"
    means = [numbers[k]["von_mises_mpa"]["mean"] for k in "ab"]
    assert numbers["ratio"]["mean"] == pytest.approx(means[1] / means[0])
    assert 0.5 < numbers["ratio"]["surface_layer_mean"] < 2.0


def exported(path: Path, vertices, faces) -> Path:
    trimesh.Trimesh(vertices, faces, process=False).export(path)
    return path


def test_thin_parts_are_warned_about(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    """On a grid of 33, two cells are 6.6 mm."""
    plate = trimesh.creation.box((1.0, 0.04, 1.0))
    settings = {**COARSE, "edge_mm": 3.5, "out": tmp_path / "out"}
    simulate(exported(tmp_path / "plate.ply", plate.vertices, plate.faces), **settings)
    fraction = json.loads((tmp_path / "out" / "stress.json").read_text(encoding="utf-8"))["mesh"]["thin_fraction"]
    assert fraction > 0.8
    assert f"warning: plate.ply is thinner than two grid cells under {fraction:.0%} of its" in capsys.readouterr().err


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


def test_a_missing_file(tmp_path: Path) -> None:
    with pytest.raises(AssetError, match="does not exist"):
        simulate(tmp_path / "missing.glb", out=tmp_path / "out", **COARSE)


class TestWithoutTheWork:
    """What reaches the functions that do the work, and what of their results is printed."""

    def test_dataset(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture) -> None:
        calls = []

        def build(out, count, settings, *, progress, **options):
            progress.stage("simulating samples")
            progress.warn("sample 3 failed: too thin")
            progress.advance(2, 4)
            calls.append((out, count, settings, options))
            return SimpleNamespace(finished=3, failed=1, added=2)

        monkeypatch.setattr(data, "build", build)
        command = ["stress", "dataset", "--out", str(tmp_path), "--count", "4", "--grid", "33", "--split", "test"]
        assert cli.main([*command, "--workers", "1", "--same", "a=b"]) == 0
        captured = capsys.readouterr()
        assert captured.err == "warning: sample 3 failed: too thin\n"
        assert captured.out == f"{tmp_path}: 3 samples, 1 failed; 2 new.\n"
        ((out, count, settings, options),) = calls
        assert (out, count, settings.simulation.grid, settings.same) == (tmp_path, 4, 33, {"a": "b"})
        assert options == {"workers": 1, "retry_failed": False, "splits": ("test",)}
        assert cli.main([*command, "--same", "a"]) == 2

    def test_train(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture) -> None:
        calls = []

        def train(*arguments, progress, **options):
            progress.advance(1, 2, {"loss": 0.5})
            calls.append((arguments, options))
            return {"steps_made": 2, "validation": {"all": {"mae": 0.1, "mean": 0.4, "iou": 0.7}}}

        monkeypatch.setattr(trainer, "train", train)
        assert cli.main(["stress", "train", "--data", "d", "--out", "o", "--steps", "2", "--resume"]) == 0
        assert "2 steps; validation: 0.1000 MPa mean error" in capsys.readouterr().out
        ((arguments, options),) = calls
        assert arguments == (Path("d"), Path("o"), TrainConfig(steps=2))
        assert options == {"cache": Path("d-decoded"), "resume": True, "force": False}


class TestPredict:
    @pytest.fixture
    def settings(self, monkeypatch: pytest.MonkeyPatch) -> list[Settings | None]:
        """Those of each predictor that is made; one knows parts of 80 mm in PETG, and predicts nothing."""
        made = []

        class Predictor:
            def __init__(self, file=None, device="auto", precision="auto", settings=None) -> None:
                made.append(settings)
                self.settings = settings or Settings(size_mm=80.0, material="petg", grid=33)
                self.known = settings is None

            def predict(self, vertices, faces):
                raise SolidError("known" if self.known else "unknown")

        monkeypatch.setattr(predictor, "Predictor", Predictor)
        return made

    def test_settings_of_the_training_by_default(self, settings, block: Path, tmp_path: Path, capsys) -> None:
        assert cli.main(["stress", "predict", str(block), "--out", str(tmp_path / "out")]) == 2
        assert settings == [None] and capsys.readouterr().err == "error: known\n"

    @pytest.mark.parametrize(
        ("arguments", "changes"),
        [
            (["--size-mm", "60"], {"size_mm": 60.0}),
            (["--material", "abs", "--protocol.step-s", "30"], {"material": "abs", "protocol": Protocol(step_s=30.0)}),
        ],
    )
    def test_those_that_are_given_replace_them(self, settings, block, tmp_path, capsys, arguments, changes) -> None:
        assert cli.main(["stress", "predict", str(block), "--out", str(tmp_path / "out"), *arguments]) == 2
        assert settings[-1] == replace(Settings(size_mm=80.0, material="petg", grid=33), **changes)
        assert capsys.readouterr().err == "error: unknown\n"

    @pytest.mark.parametrize("arguments", [["--size-mm", "0"], ["--material", "wood"], ["--protocol.step-s", "0"]])
    def test_a_bad_setting(self, settings, block: Path, tmp_path: Path, capsys, arguments) -> None:
        assert cli.main(["stress", "predict", str(block), "--out", str(tmp_path / "out"), *arguments]) == 2
        assert capsys.readouterr().err.startswith("error: ")


def test_warnings_of_a_prediction_are_printed(block: Path, tmp_path: Path, monkeypatch, capsys) -> None:
    """A size that the network was not trained for."""
    monkeypatch.setattr(output, "write_prediction_vtu", lambda *_: None)
    monkeypatch.setattr(output, "write_grid", lambda *_: None)
    numbers = {"von_mises_mpa": {"mean": 0.4, "p99_9": 2.0}, "surface_band": {"mean": 0.5}}
    monkeypatch.setattr(predictor, "summary", lambda _: numbers)

    class Predictor:
        settings, about = Settings(), {"preset": "compact"}

        def __init__(self, file=None, device="auto", precision="auto", settings=None) -> None:
            self.warnings = [f"trained for 100 mm, not {settings.size_mm:g} mm"] if settings else []

        def predict(self, vertices, faces) -> SimpleNamespace:
            return SimpleNamespace(warnings=self.warnings, field=None)

    monkeypatch.setattr(predictor, "Predictor", Predictor)
    command = ["stress", "predict", str(block), "--no-picture", "--force", "--out", str(tmp_path / "out")]
    assert cli.main(command) == 0 and capsys.readouterr().err == ""
    assert cli.main([*command, "--size-mm", "60"]) == 0
    assert capsys.readouterr().err == "warning: block.ply: trained for 100 mm, not 60 mm.\n"

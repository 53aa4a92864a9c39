"""The predictor: from a mesh to the field in one call, with warnings, and files that others can read."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

from genmf_mi.cli import stress as commands
from genmf_mi.cli.main import main
from genmf_mi.core.errors import SolidError
from genmf_mi.sdf.distance import signed_distance
from genmf_mi.sdf.redistance import redistance
from genmf_mi.stress.fem.coarse import EDGE_MM
from genmf_mi.stress.fem.simulation import Settings
from genmf_mi.stress.model import domain, predictor, weights
from genmf_mi.stress.model.network import Architecture, StressNetwork, crop_box
from genmf_mi.stress.model.predictor import Predictor, summary
from genmf_mi.stress.model.weights import WeightsError

N = 33
SETTINGS = Settings(grid=N, edge_mm=6.0, size_mm=80.0)


def ball(stretch: tuple[float, float, float] = (3.0, 2.0, 2.5)) -> trimesh.Trimesh:
    mesh = trimesh.creation.icosphere(subdivisions=3)
    return trimesh.Trimesh(mesh.vertices * stretch + [1.0, 2.0, 3.0], mesh.faces, process=False)


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An untrained network that says it was trained on balls."""
    torch.manual_seed(0)
    net = StressNetwork(Architecture(4, block_size=2, poolings=2, grid=N))
    torch.nn.init.constant_(net.fusion.out.bias, 0.2)
    shapes = []
    for k in range(4):
        body = trimesh.creation.icosphere(subdivisions=2)
        shapes.append(
            torch.from_numpy(signed_distance(body.vertices * [0.95, 0.5 + 0.1 * k, 0.7], body.faces, N))[None]
        )
    path = tmp_path_factory.mktemp("weights") / "tiny.safetensors"
    weights.save(path, net, "compact", asdict(SETTINGS), {"domain": domain.ranges(shapes)})
    return path


def test_one_call_is_the_network_on_the_distance(file: Path) -> None:
    mesh = ball()
    tiny = Predictor(file, precision="float32")
    assert tiny.settings == replace(SETTINGS, edge_mm=Settings().edge_mm)
    prediction = tiny.predict(mesh.vertices, mesh.faces)
    frame = prediction.frame
    assert frame.size_mm == 80.0 and np.allclose(frame.centre, [1, 2, 3])
    phi = signed_distance(frame.normalise(mesh.vertices), mesh.faces, N)
    assert (prediction.phi == phi).all()
    net, _ = weights.load(file)
    shape = torch.from_numpy(redistance(phi))[None]
    box = crop_box(shape)
    with torch.no_grad():
        raw = 3 * torch.expm1(net(shape[:, *box][None]))[0, 0].clamp_min(0).numpy()
    inside = phi <= 0
    assert inside.sum() == inside[box].sum(), "the crop holds all of the body"
    assert np.allclose(prediction.von_mises[box][inside[box]], raw[inside[box]], atol=1e-5)
    assert (prediction.von_mises[~inside] == 0).all() and (prediction.von_mises >= 0).all()
    assert prediction.warnings == []


def test_the_field_is_differentiable_and_the_weights_are_fixed(file: Path) -> None:
    tiny = Predictor(file, precision="float32")
    mesh = ball((0.9, 0.6, 0.7))
    phi = torch.from_numpy(signed_distance(mesh.vertices - [1, 2, 3], mesh.faces, N))[None].requires_grad_()
    tiny.field(phi)[phi <= 0].mean().backward()
    assert phi.grad.abs()[phi <= 0].mean() > 0
    assert all(p.grad is None for p in tiny.network.parameters())


def test_numbers(file: Path) -> None:
    prediction = Predictor(file).predict(*(getattr(ball(), name) for name in ("vertices", "faces")))
    numbers = summary(prediction)
    value = prediction.von_mises[prediction.phi <= 0]
    assert numbers["von_mises_mpa"]["mean"] == pytest.approx(value.mean())
    assert numbers["von_mises_mpa"]["p50"] <= numbers["von_mises_mpa"]["p99_9"] <= numbers["von_mises_mpa"]["max"]
    volume = ball().volume * (80 / 6) ** 3
    assert numbers["mesh"]["volume_mm3"] == pytest.approx(volume, rel=0.02)
    shell = volume - 4 / 3 * np.pi * np.prod(40 * np.array([1, 2 / 3, 5 / 6]) - 4)
    assert numbers["surface_band"]["volume_fraction"] == pytest.approx(shell / volume, abs=0.04)
    assert json.loads(json.dumps(numbers))["settings"]["protocol"]["ramp_s"] == 1200.0


def test_unlike_shapes_are_named(file: Path) -> None:
    tiny = Predictor(file)
    plate = trimesh.creation.box((4.0, 0.25, 4.0))
    warnings = " ".join(tiny.predict(plate.vertices, plate.faces).warnings)
    assert "smallest extent" in warnings and "mean depth" in warnings and "thinner than two grid cells" in warnings
    assert "largest extent is" not in " ".join(tiny.predict(ball().vertices, ball().faces).warnings)


def test_descriptors_of_a_box() -> None:
    """20 × 10 × 16 samples, by hand: depth is that of the nearest face."""
    phi = np.ones((N, N, N), dtype=np.float32)
    x, y, z = np.ogrid[:20, :10, :16]
    depth = np.minimum(np.minimum(np.minimum(x, 19 - x), np.minimum(y, 9 - y)), np.minimum(z, 15 - z))
    phi[5:25, 3:13, 8:24] = -depth * 2 / (N - 1)
    row = domain.descriptors(torch.from_numpy(phi)[None])
    assert row["filled"] == 1.0 and row["flatness"] == 0.5 and row["height"] == 0.5
    assert row["thickness"] == pytest.approx(depth.mean()) and row["thickest"] == 4.0
    assert row["skin"] == pytest.approx((depth < 1).mean())


def test_bad_input(file: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    tiny = Predictor(file)
    with pytest.raises(SolidError, match="not numbers"):
        tiny.predict(np.full((4, 3), np.nan), np.array([[0, 1, 2]]))
    with pytest.raises(WeightsError, match="does not exist"):
        Predictor(tmp_path / "none.safetensors")
    monkeypatch.setattr(weights, "file_of", lambda name: file)
    with pytest.raises(WeightsError, match="SHA-256"):
        Predictor()
    monkeypatch.setitem(weights.PACKAGED, "compact", weights.digest(file))
    assert Predictor().about["preset"] == "compact"


def test_where_the_training_does_not_reach() -> None:
    trained = Settings()
    assert predictor.untrained(replace(trained, edge_mm=1.0, size_mm=109.0, material="PLA"), trained) == ""
    for change, words in (
        ({"size_mm": 111.0}, "parts of 100 mm (not 111 mm)"),
        ({"material": "abs"}, "pla (not abs)"),
        ({"protocol": replace(trained.protocol, ramp_s=600.0)}, "another protocol"),
        ({"grid": 65}, "129³ samples (not 65³)"),
    ):
        assert words in predictor.untrained(replace(trained, **change), trained)


def test_other_parts_have_the_coarse_field_alone(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where the network, if it were used, would not need it; of the settings of the part."""
    settings = replace(SETTINGS, size_mm=40.0)
    small, phi = Predictor(file, settings=settings), torch.rand(1, N, N, N)

    def coarse_stress(shape: torch.Tensor, part: Settings, edge_mm: float) -> torch.Tensor:
        assert shape is phi and part == settings and edge_mm == EDGE_MM
        return shape + 1

    monkeypatch.setattr(predictor, "coarse_stress", coarse_stress)
    assert torch.equal(small.field(phi), phi + 1)


def test_command_writes_its_files(file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    import meshio

    asset, out = tmp_path / "ball.ply", tmp_path / "out"
    ball().export(asset)
    command = ["stress", "predict", str(asset), "--out", str(out), "--weights", str(file), "--device", "cpu"]
    assert main([*command, "--no-picture"]) == 0
    assert "mean" in capsys.readouterr().out
    numbers = json.loads((out / "stress.json").read_text(encoding="utf-8"))
    assert numbers["asset"] == "ball.ply" and numbers["warnings"] == []
    mesh = meshio.read(out / "stress.vtu")
    assert np.ptp(mesh.points, axis=0) == pytest.approx([80, 66.7, 53.3], rel=0.02), "millimetres, z up"
    assert mesh.points[:, 2].min() == pytest.approx(0.0, abs=1e-9)
    nodes = mesh.point_data["von_mises_MPa"]
    assert np.isfinite(nodes).all() and nodes.mean() == pytest.approx(numbers["von_mises_mpa"]["mean"], rel=0.3)
    with np.load(out / "stress.npz") as grid:
        assert set(grid.files) == {"phi", "von_mises_mpa", "centre", "scale", "size_mm"}
        assert grid["von_mises_mpa"].shape == (N, N, N)
    assert main(command) == 2
    assert "--force" in capsys.readouterr().err


def test_a_prediction_can_be_drawn(file: Path) -> None:
    from genmf_mi.stress.report.picture import surface_field

    prediction = Predictor(file).predict(ball().vertices, ball().faces)
    vertices, faces, value = surface_field(prediction)
    assert len(vertices) == len(value) and faces.max() < len(vertices)
    assert np.abs(np.linalg.norm(vertices / (0.95 * np.array([1, 2 / 3, 5 / 6])), axis=1) - 1).max() < 0.1


def test_settings_of_weights(file: Path) -> None:
    _, about = weights.load(file)
    assert weights.settings_of(about["simulation"]) == SETTINGS
    assert weights.settings_of({**about["simulation"], "grid": 65}) == replace(SETTINGS, grid=65)
    assert "predict" in commands.COMMANDS

"""The verdict on what comes off the printer: a small painted shape, sliced by our own slicer."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh
from PIL import Image
from toy_runs import CONFIG, Recorder

import genmf_mi
from genmf_mi.assets.asset import Asset
from genmf_mi.cli.main import main
from genmf_mi.core.errors import ConfigError, SetupError
from genmf_mi.pipeline import as_printed
from genmf_mi.pipeline.print_check import print_check

pytestmark = pytest.mark.usefixtures("small_refinements")
FILAMENT = replace(CONFIG, printer="fdm-0.2", size_mm=30.0, iterations=3)


@pytest.fixture(autouse=True)
def small_pictures(monkeypatch):
    monkeypatch.setattr(as_printed, "RESOLUTION", 96)
    monkeypatch.setattr(as_printed, "SAMPLES_LAMPS", 4)


def grooved(toy: Asset) -> Asset:
    """The toy with its dark stripes as grooves."""
    normals = trimesh.Trimesh(toy.vertices, toy.faces, process=False).vertex_normals
    dark = toy.closest_albedo(toy.vertices, normals)[:, 0] < 0.5
    return Asset.from_arrays("grooved", toy.vertices - 0.03 * dark[:, None] * normals, toy.faces)


class TestPrintCheck:
    def test_scores_and_pictures(self, toy, two_views, tmp_path):
        check = print_check(grooved(toy), toy, slicer="own", size_mm=30, scene=two_views)
        assert check.metrics["printer"] == "fdm-0.2" and check.metrics["slicer"] == "own"
        for light in ("two_lights", "lamps"):
            scores = check.metrics[light]
            for shape in ("before", "after"):
                assert 0.5 < scores[shape]["ssim"] <= 1
                assert 0 < scores["paper_alignment"][shape]["lpips_alex"] < 1
            assert scores["after"]["lpips_alex"] < scores["before"]["lpips_alex"]
        check.write(tmp_path / "picture.png")
        with Image.open(tmp_path / "picture.png") as picture:
            assert picture.width > 3 * 96 and picture.height > 2 * 96

    def test_unpainted_print_is_its_own_target(self, toy, two_views):
        """Of an object of one colour nothing is missing."""
        colours = np.full((len(toy.vertices), 3), 0.8)
        colours[::2] -= 1e-3  # paint that no one sees, as an object of one colour has nothing to show
        plain = Asset.from_arrays("plain", toy.vertices, toy.faces, colours=colours)
        scores = print_check(plain, plain, slicer="own", size_mm=30, scene=two_views).metrics["two_lights"]
        assert scores["before"]["lpips_alex"] < 0.01 and scores["before"]["ssim"] > 0.99

    def test_without_a_texture_it_only_looks(self, toy, two_views):
        check = print_check(grooved(toy), slicer="own", size_mm=30, scene=two_views)
        assert set(check.metrics) == {"printer", "slicer", "parts"}
        assert 115 <= check.metrics["parts"]["part"]["layers"] <= 120  # 30 mm · 0.8 / 0.2 mm, less the grooves

    def test_printers_without_layers_and_slicers_that_are_not_there(self, toy):
        with pytest.raises(ConfigError, match=r"with resin: choose one of fdm-0\.2"):
            print_check(toy, printer="resin")
        with pytest.raises(SetupError, match="no slicer /nowhere"):
            print_check(toy, slicer="/nowhere")
        with pytest.raises(ConfigError, match="larger than what the printer holds"):
            print_check(toy, slicer="own", size_mm=400)


class TestRefine:
    def test_looks_at_all_shapes(self, toy, two_views, tmp_path):
        out = tmp_path / "run"
        result = genmf_mi.refine(toy, FILAMENT, out=out, scene=two_views, print_check="own")
        printed = json.loads((out / "metrics.json").read_text())["as_printed"]
        assert set(printed["parts"]) == {"before", "displacement", "after"}
        assert printed["lamps"]["after"]["lpips_alex"] == result.metrics["as_printed"]["lamps"]["after"]["lpips_alex"]
        assert (out / "as_printed.png").exists()
        assert "As printed" in (out / "report.html").read_text(encoding="utf-8")
        again = print_check(out, slicer="own", size_mm=30, scene=two_views).metrics["parts"]["part"]
        # Print files are rounded
        assert again["printability"]["first_layer_mm2"] == pytest.approx(
            printed["parts"]["after"]["printability"]["first_layer_mm2"], rel=0.01
        )

    def test_a_slicer_that_fails_takes_nothing_with_it(self, toy, two_views, tmp_path):
        program = tmp_path / "prusa-slicer"
        program.write_text("#!/bin/sh\nexit 3\n")
        program.chmod(0o755)
        heard = Recorder()
        out = tmp_path / "run"
        result = genmf_mi.refine(toy, FILAMENT, out=out, scene=two_views, print_check=str(program), progress=heard)
        assert "as_printed" not in result.metrics and (out / "refined.3mf").exists()
        assert any("not looked at as printed" in warning for warning in heard.warnings)

    def test_nothing_to_look_at(self, toy):
        with pytest.raises(ConfigError, match=r"choose one of fdm-0\.2"):
            genmf_mi.refine(toy, replace(FILAMENT, printer="smooth"), print_check=True)

    def test_larger_than_the_printer(self, toy):
        with pytest.raises(ConfigError, match=r"larger than what the printer holds \(143 × 89 × 175 mm\)"):
            genmf_mi.refine(toy, replace(FILAMENT, printer="resin", size_mm=150.0))

    def test_shadows_are_for_filament(self):
        assert FILAMENT.shadows and not replace(FILAMENT, printer="resin").shadows and not CONFIG.shadows


def test_command(toy, two_views, tmp_path, capsys):
    part = tmp_path / "part.stl"
    trimesh.Trimesh(toy.vertices[:, [0, 2, 1]] * (1, -1, 1), toy.faces).export(part)
    words = ["print-check", str(part), "--slicer", "own", "--size-mm", "30", "--scene", str(two_views), "--quiet"]
    assert main(words) == 0
    assert "layers" in capsys.readouterr().out
    assert (tmp_path / "as_printed.png").exists()
    assert main([*words, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["slicer"] == "own"
    assert main(["print-check", str(part), "--slicer", "/nowhere"]) == 2
    assert "--slicer own" in capsys.readouterr().err


def test_from_afar_nothing_is_lost_and_layers_merge():
    """The mean stays, and stripes of two fine pixels are even grey."""
    image = torch.zeros(1, 1, 64, 64)
    image[..., 16:48, 16:48] = 1
    assert float(as_printed.far(image, 4).mean()) == pytest.approx(float(image.mean()), rel=1e-5)
    image[..., ::4, :], image[..., 1::4, :], image[..., 2::4, :], image[..., 3::4, :] = 1, 1, 0, 0
    middle = as_printed.far(image, 4)[..., 4:-4, 4:-4]
    assert middle.min() > 0.48 and middle.max() < 0.52

"""Refinements by other ways than the usual one, and those that are refused before any work."""

from __future__ import annotations

import os
from dataclasses import replace

import numpy as np
import pytest
import torch
from PIL import Image
from toy_runs import CONFIG, Recorder, difference_mm, ellipsoid
from toys import painted, stripes

import genmf_mi
from genmf_mi.assets.asset import Asset
from genmf_mi.core.errors import AssetError, ConfigError, OptimisationError, OutputError, SetupError
from genmf_mi.geometry.low_pass import low_frequency
from genmf_mi.pipeline import optimisation, refinement
from genmf_mi.pipeline.detail import local_contrast
from genmf_mi.pipeline.run_folder import CHECKPOINT
from genmf_mi.render import scene, variant

SCORES = {"ssim", "lpips_alex", "lpips_vgg", "g_ssim", "g_lpips"}

pytestmark = pytest.mark.usefixtures("small_refinements")


class TestNoRelief:
    @pytest.mark.parametrize("noise", [0, 1])
    def test_a_grey_texture_is_refused_before_the_work(self, two_views, noise):
        """Also with the noise of an 8-bit picture."""
        vertices, faces = ellipsoid()
        texture = np.full((64, 64, 3), 128, np.uint8)
        texture += np.random.default_rng(0).integers(0, noise + 1, (64, 64, 1), dtype=np.uint8)
        uv = vertices[:, :2] / 2 + 0.5
        grey = Asset.from_arrays("grey", vertices, faces, uv=uv, texture=texture)
        with pytest.raises(AssetError, match="one brightness all over"):
            genmf_mi.refine(grey, replace(CONFIG, iterations=10), scene=two_views)

    def test_a_cap_of_zero(self, toy, two_views):
        result = genmf_mi.refine(toy, replace(CONFIG, iterations=2, max_relief_mm=0.0), scene=two_views)
        assert result.metrics["relief_mm"]["max"] < 1e-6
        assert result.metrics["after"]["ssim"] == pytest.approx(result.metrics["before"]["ssim"], abs=1e-4)


class TestGradientsThatAreNotFinite:
    def test_some_are_counted_and_told(self, toy, two_views, monkeypatch):
        """They count as 0, and neither the user nor the metrics are left in the dark."""
        backward = torch.Tensor.backward

        def spoiled(loss, *arguments):
            backward(loss, *arguments)
            (parameter,) = runs[-1].parameterization.parameters
            parameter.grad[:3, 0] = torch.nan

        runs = []
        created = optimisation.Optimisation.__post_init__
        monkeypatch.setattr(
            optimisation.Optimisation, "__post_init__", lambda self: (created(self), runs.append(self))[0]
        )
        monkeypatch.setattr(torch.Tensor, "backward", spoiled)
        recorder = Recorder()
        result = genmf_mi.refine(toy, replace(CONFIG, iterations=2), scene=two_views, progress=recorder)
        assert result.metrics["nonfinite_gradients"] == 6
        assert [line["nonfinite_gradients"] for line in result.history] == [3, 3]
        assert any("not finite" in warning for warning in recorder.warnings)

    def test_nothing_else_ends_the_run(self, toy, two_views):
        def broken(image, reference, geometry):
            return {"broken": geometry.vertices.sum() * torch.nan}

        config = replace(CONFIG, iterations=20)
        recorder = Recorder()
        with pytest.raises(OptimisationError, match=r"not finite for 5 iterations.*--learning-rate"):
            genmf_mi.refine(toy, config, scene=two_views, extra_terms=broken, progress=recorder)
        assert len(recorder.records) == 4


class TestExtraTerms:
    def test_join_the_loss_and_the_history(self, toy, two_views, twin):
        """A pull to one side shows in the shape, and the loss holds it once."""

        def upwards(image, reference, geometry):
            assert image.grey.shape == reference.grey.shape
            return {"upwards": -3 * geometry.vertices[:, 1].mean()}

        result = genmf_mi.refine(toy, CONFIG, scene=two_views, extra_terms=upwards)
        weights = vars(CONFIG.weights)
        for line in result.history:
            total = sum(weights[name] * value for name, value in line.items() if name in weights)
            assert line["loss"] == pytest.approx(total + line["upwards"], rel=1e-4)
        assert result.vertices[:, 1].mean() > twin.vertices[:, 1].mean()


class TestWays:
    def test_displacement(self, toy, two_views, tmp_path):
        """The baseline alone: it is what the scores of `displacement` stand for."""
        result = genmf_mi.refine(toy, replace(CONFIG, method="displacement"), out=tmp_path / "run", scene=two_views)
        metrics = result.metrics
        assert metrics["iterations"] == 0 and result.history == []
        assert metrics["displacement_amplitude"] in (-0.5, 0.5)
        for name in SCORES - {"lpips_vgg"}:
            assert metrics["after"][name] == pytest.approx(metrics["displacement"][name], abs=1e-3)
        assert 0 < metrics["relief_mm"]["max"] <= CONFIG.max_relief_mm
        bright = stripes(result.vertices).max(axis=1) > 0.5
        raised = result.relief_mm[bright].mean() - result.relief_mm[~bright].mean()
        assert raised * metrics["displacement_amplitude"] > 0
        assert CHECKPOINT not in os.listdir(tmp_path / "run")

    def test_from_pictures(self, two_views, tmp_path):
        """A mesh without colours and one picture: its view is the one that counts, and there are no unseen ones."""
        y, x = np.mgrid[:120, :120] - 59.5
        inside = np.hypot(x / 58, y / 48) < 1
        pixels = np.where((np.sin(y / 5) > 0)[..., None], (230, 60, 60), (60, 60, 60))
        Image.fromarray(np.dstack([pixels, 255 * inside]).astype(np.uint8)).save(tmp_path / "front.png")
        plain = Asset.from_arrays("plain", *ellipsoid())
        with pytest.raises(AssetError, match="--reference"):
            genmf_mi.refine(plain, CONFIG, scene=two_views)
        result = genmf_mi.refine(plain, replace(CONFIG, iterations=3), scene=two_views, out=tmp_path / "run",
                                 references=(f"{tmp_path / 'front.png'}@0,0",))  # fmt: skip
        assert "unseen" not in result.metrics and set(result.metrics["after"]) >= SCORES
        assert result.metrics["relief_mm"]["max"] > 1e-3
        assert (tmp_path / "run" / "report.html").stat().st_size > 50_000

    def test_silhouettes(self, toy, two_views):
        result = genmf_mi.refine(toy, replace(CONFIG, iterations=2, silhouettes=True), scene=two_views)
        assert "teacher_depth" not in result.history[0] and np.isfinite(result.history[-1]["loss"])
        assert result.metrics["solid"]["watertight"]

    def test_without_iterations(self, toy, two_views, tmp_path):
        result = genmf_mi.refine(toy, replace(CONFIG, iterations=0), out=tmp_path / "run", scene=two_views)
        assert result.history == [] and (tmp_path / "run" / "metrics.jsonl").read_text() == ""

    def test_nothing_is_written_unasked(self, toy, two_views, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "scratch"))
        (tmp_path / "scratch").mkdir()
        genmf_mi.refine(toy, replace(CONFIG, iterations=1), scene=two_views)
        assert os.listdir(tmp_path) == ["scratch"] and os.listdir(tmp_path / "scratch") == []

    def test_on_the_gpu(self, toy, two_views, twin):
        if not variant.cuda_available():
            with pytest.raises(SetupError, match="no CUDA device"):
                genmf_mi.refine(toy, replace(CONFIG, device="cuda"), scene=two_views)
            pytest.skip("no CUDA device is visible to both torch and Dr.Jit")
        result = genmf_mi.refine(toy, replace(CONFIG, device="cuda"), scene=two_views)
        variant.use("cpu")
        assert difference_mm(result, twin) < 0.2
        for name in ("ssim", "lpips_alex"):
            assert result.metrics["after"][name] == pytest.approx(twin.metrics["after"][name], abs=5e-3)


class TestRefusedBeforeTheWork:
    @pytest.fixture(autouse=True)
    def _no_work(self, monkeypatch):
        monkeypatch.setattr(
            refinement, "build_problem", lambda *_, **__: pytest.fail("this should have been refused before")
        )

    def test_a_finished_run(self, toy, tmp_path):
        (tmp_path / "metrics.json").write_text("{}")
        (tmp_path / "config.yaml").write_text("asset: toy\nsize_mm: 100.0\niterations: 6\n")
        with pytest.raises(OutputError, match="finished run"):
            genmf_mi.refine(toy, CONFIG, out=tmp_path)

    def test_resume_without_a_folder(self, toy):
        with pytest.raises(ConfigError, match="--out"):
            genmf_mi.refine(toy, CONFIG, resume=True)

    def test_folder_that_cannot_be_written(self, toy, tmp_path):
        (tmp_path / "file").touch()
        with pytest.raises(OutputError, match=r"cannot (read|write)"):
            genmf_mi.refine(toy, CONFIG, out=tmp_path / "file")

    def test_an_asset_within_the_results(self, tmp_path):
        mine = painted(tmp_path / "refined.glb")
        before = (tmp_path / "refined.glb").read_bytes()
        with pytest.raises(ConfigError, match="where the results go"):
            genmf_mi.refine(mine, CONFIG, out=tmp_path, force=True)
        assert (tmp_path / "refined.glb").read_bytes() == before

    def test_no_such_asset(self):
        with pytest.raises(AssetError, match=r"nowhere\.glb"):
            genmf_mi.refine("nowhere.glb", CONFIG)


class TestLocalContrast:
    """What decides how much of the cap an object gets."""

    @staticmethod
    def of(brightness) -> float:
        vertices, faces = ellipsoid()
        field = brightness(vertices)
        return local_contrast(np.abs(field - low_frequency(vertices, faces, field, 0.16)))

    def test_one_brightness_has_none(self):
        assert self.of(lambda v: np.full(len(v), 0.7)) == pytest.approx(0, abs=1e-6)

    def test_a_blush_has_little(self):
        assert self.of(lambda v: 0.5 + 0.3 * v[:, 1]) < 0.03

    def test_stripes_have_much(self):
        assert self.of(lambda v: np.where(np.sin(15 * v[:, 1]) > 0, 0.9, 0.2)) > 0.2

    def test_in_proportion(self):
        wave = [self.of(lambda v, a=a: 0.5 + a * np.sin(30 * v[:, 1])) for a in (0.1, 0.2)]
        assert wave[1] == pytest.approx(2 * wave[0], rel=1e-3)


def test_scene_of_a_sample_is_its_own(monkeypatch, toy):
    """A bundled sample brings its views along; `scene` overrides them."""
    asked = []
    monkeypatch.setattr(
        refinement, "build_problem", lambda asset, config, xml, *_, **__: asked.append(xml) or pytest.skip
    )
    for name, given in (("globe", None), ("toy", None), ("globe", scene.find("leaf"))):
        with pytest.raises(AttributeError):
            genmf_mi.refine(replace(toy, name=name), CONFIG, scene=given)
    assert [path.stem for path in asked] == ["globe", "default", "leaf"]

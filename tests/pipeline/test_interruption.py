"""The same twice, interrupted and resumed."""

from __future__ import annotations

import os
from dataclasses import replace

import drjit as dr
import numpy as np
import pytest
import torch
import trimesh
from toy_runs import COARSE_STRESS, CONFIG, TOLERANCE_MM, Recorder, difference_mm, ellipsoid
from toys import stripes

import genmf_mi
from genmf_mi.assets.asset import Asset
from genmf_mi.core.errors import ConfigError, OutputError
from genmf_mi.geometry import uniform_adam
from genmf_mi.pipeline import optimisation
from genmf_mi.pipeline.checkpoint import Checkpoint
from genmf_mi.pipeline.run_folder import CHECKPOINT, STOP

SCORES = {"ssim", "lpips_alex", "lpips_vgg", "g_ssim", "g_lpips"}

pytestmark = pytest.mark.usefixtures("small_refinements")


class TestSameTwice:
    def test_same_seed(self, whole, twin):
        assert difference_mm(whole[0], twin) < TOLERANCE_MM
        for name in ("ssim", "g_ssim", "lpips_alex"):
            assert twin.metrics["after"][name] == pytest.approx(whole[0].metrics["after"][name], abs=1e-3)
        assert twin.history[0]["loss"] == pytest.approx(whole[0].history[0]["loss"], rel=1e-4)

    def test_another_seed(self, toy, two_views, twin):
        other = genmf_mi.refine(toy, replace(CONFIG, seed=1), scene=two_views)
        assert difference_mm(other, twin) > 10 * TOLERANCE_MM


class TestInterrupted:
    def test_by_ctrl_c_and_resumed(self, toy, two_views, twin, tmp_path):
        """What there is gets finished and written; the resumed run ends where the uninterrupted one did."""
        stopped = genmf_mi.refine(toy, CONFIG, out=tmp_path / "run", scene=two_views, progress=Recorder(stop=3))
        assert stopped.metrics["interrupted"] is True and stopped.metrics["iterations"] == 3
        assert {"refined.3mf", "report.html", "metrics.json", CHECKPOINT} <= set(os.listdir(tmp_path / "run"))
        assert trimesh.load(tmp_path / "run" / "refined.stl").is_watertight
        assert difference_mm(stopped, twin) > 10 * TOLERANCE_MM
        with pytest.raises(OutputError, match="interrupted run"):
            genmf_mi.refine(toy, CONFIG, out=tmp_path / "run", scene=two_views)

        resumed = genmf_mi.refine(toy, CONFIG, out=tmp_path / "run", scene=two_views, resume=True)
        assert resumed.metrics["interrupted"] is False
        assert [line["iteration"] for line in resumed.history] == list(range(6))
        assert resumed.history[:3] == stopped.history
        assert CHECKPOINT not in os.listdir(tmp_path / "run")
        assert difference_mm(resumed, twin) < TOLERANCE_MM

    def test_by_a_crash_in_the_middle_of_a_step(self, toy, two_views, twin, tmp_path, monkeypatch):
        """Ctrl-C between the two moments of Adam, then a crash: neither leaves a trace in what follows."""
        percentile, calls = uniform_adam.percentile, []

        def interrupted(*arguments):
            calls.append(1)
            if len(calls) == 2 * 3 + 2:  # twice a step; now between its two halves in the fourth
                raise KeyboardInterrupt
            return percentile(*arguments)

        with monkeypatch.context() as patch:
            patch.setattr(uniform_adam, "percentile", interrupted)
            stopped = genmf_mi.refine(toy, CONFIG, out=tmp_path / "run", scene=two_views)
        assert stopped.metrics["iterations"] == 3
        with pytest.raises(RuntimeError):
            genmf_mi.refine(toy, CONFIG, out=tmp_path / "run", scene=two_views, resume=True,
                            progress=Recorder(stop=5, error=RuntimeError))  # fmt: skip
        heard = Recorder()
        resumed = genmf_mi.refine(toy, CONFIG, out=tmp_path / "run", scene=two_views, resume=True, progress=heard)
        assert [done for done, *_ in heard.records] == [5, 6]  # from the checkpoint after the fourth iteration
        assert [line["iteration"] for line in resumed.history] == list(range(6))
        assert difference_mm(resumed, twin) < TOLERANCE_MM

    def test_by_a_request_in_its_folder_and_resumed(self, toy, two_views, twin, tmp_path):
        """A file asks the run to stop; one that was left before it went on asks for nothing."""

        class Asking(Recorder):
            def advance(self, done, total, values=None):
                super().advance(done, total, values)
                if values is not None and done in (2, CONFIG.iterations):
                    (tmp_path / "run" / STOP).touch()

        stopped = genmf_mi.refine(toy, CONFIG, out=tmp_path / "run", scene=two_views, progress=Asking())
        assert stopped.metrics["interrupted"] is True and stopped.metrics["iterations"] == 2
        assert {"refined.3mf", "report.html", CHECKPOINT} <= set(os.listdir(tmp_path / "run"))
        assert STOP not in os.listdir(tmp_path / "run")
        (tmp_path / "run" / STOP).touch()
        resumed = genmf_mi.refine(
            toy, CONFIG, out=tmp_path / "run", scene=two_views, resume=True, progress=Asking()
        )  # a request after the last iteration changes nothing
        assert resumed.metrics["interrupted"] is False and resumed.metrics["iterations"] == CONFIG.iterations
        assert {CHECKPOINT, STOP}.isdisjoint(os.listdir(tmp_path / "run"))
        assert difference_mm(resumed, twin) < TOLERANCE_MM

    def test_the_asset_was_changed_meanwhile(self, toy, two_views, tmp_path):
        genmf_mi.refine(toy, CONFIG, out=tmp_path / "run", scene=two_views, progress=Recorder(stop=1))
        vertices, faces = ellipsoid()
        other = Asset.from_arrays("toy", vertices * (1, 0.5, 1), faces, colours=stripes(vertices))
        with pytest.raises(ConfigError, match="another content of the asset"):
            genmf_mi.refine(other, CONFIG, out=tmp_path / "run", scene=two_views, resume=True)


LONGER = replace(CONFIG, iterations=14, stress=True, stress_weight=10.0, stage_one_share=0.5, stress_every=3)


@pytest.fixture(scope="module")
def one_thread():
    """Sums over faces and pixels are then taken in one order, so that two runs agree to the last bit."""
    rendering, learning = dr.thread_count(), torch.get_num_threads()
    dr.set_thread_count(1)
    torch.set_num_threads(1)
    yield
    dr.set_thread_count(rendering)
    torch.set_num_threads(learning)


@pytest.fixture(scope="module")
def uninterrupted(toy, two_views, small_refinements, one_thread):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(*COARSE_STRESS)
        return genmf_mi.refine(toy, LONGER, scene=two_views)


class TestResumedAtAnyIteration:
    """A killed run, continued from its last checkpoint, is the uninterrupted one to the last bit. Stage two begins
    after seven iterations and evaluates the stress every third one."""

    @pytest.mark.parametrize("killed_after", [4, 7, 8, 9, 10, 13])
    def test_ends_as_if_nothing_had_happened(
        self, toy, two_views, coarse_stress, uninterrupted, tmp_path, monkeypatch, killed_after
    ):
        monkeypatch.setattr(optimisation, "CHECKPOINT_EVERY", 1)
        run = {"out": tmp_path / "run", "scene": two_views}
        # The checkpoint of an iteration is written after its progress
        stop = Recorder(stop=killed_after + 1, error=RuntimeError)
        with pytest.raises(RuntimeError):
            genmf_mi.refine(toy, LONGER, **run, progress=stop)
        assert Checkpoint.load(tmp_path / "run" / CHECKPOINT).iteration == killed_after
        resumed = genmf_mi.refine(toy, LONGER, **run, resume=True)
        assert np.array_equal(resumed.vertices, uninterrupted.vertices)
        assert [line["stage"] for line in resumed.history] == [1] * 7 + [2] * 7
        for line, expected in zip(resumed.history, uninterrupted.history, strict=True):
            assert {**line, "seconds": 0} == {**expected, "seconds": 0}

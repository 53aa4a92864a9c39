"""The second stage: when there is one, what it is told of the part, what it does to the shape."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from toy_runs import CONFIG, TOLERANCE_MM, Recorder, Waves, difference_mm

import genmf_mi
from genmf_mi.pipeline import stress_stage
from genmf_mi.pipeline.checkpoint import Checkpoint
from genmf_mi.pipeline.run_folder import CHECKPOINT
from genmf_mi.stress.report import verification

SCORES = {"ssim", "lpips_alex", "lpips_vgg", "g_ssim", "g_lpips"}

pytestmark = pytest.mark.usefixtures("small_refinements", "coarse_verification", "coarse_stress")


@pytest.fixture
def pressing(monkeypatch) -> list[int]:
    """In place of the solver: a stress that relief raises where x is positive. Returns what grows with every look."""
    looks: list[int] = []

    def by_solver(body, follow):
        initial: list[torch.Tensor] = []

        def measure(shape):
            looks.append(1)
            initial.append(shape.detach())  # what is looked at first
            height = (shape - initial[0]).norm(dim=1) + 1e-9
            return (1 + 20 * ((shape[:, 0] > 0) * height).mean()).expand(4)

        return measure

    monkeypatch.setattr(stress_stage, "by_solver", by_solver)
    return looks


class TestStressStage:
    CONFIG = replace(CONFIG, stress=True, stress_weight=10.0, stage_one_share=0.5)

    def test_second_stage(self, toy, two_views, twin, pressing):
        """From its share on, evaluated every other iteration; in the loss and in the history. It takes relief away
        where that raises the stress, and leaves the rest."""
        result = genmf_mi.refine(toy, replace(self.CONFIG, stress_every=2), scene=two_views)
        assert len(pressing) == 1 + 2
        terms = {"stress_mean", "stress_variance", "stress_band", "stress_peak"}
        assert [line["stage"] for line in result.history] == [1, 1, 1, 2, 2, 2]
        assert [terms <= set(line) for line in result.history] == [False] * 3 + [True] * 3
        lines, other_weights = result.history, {n: w for n, w in vars(CONFIG.weights).items() if n not in terms}
        rest = [line["loss"] - sum(w * line[n] for n, w in other_weights.items() if n in line) for line in lines]
        assert rest[:3] == pytest.approx([0] * 3, abs=1e-4)
        assert lines[3]["stress_mean"] == lines[4]["stress_mean"] > 1.01
        weights = [one / line["stress"] for one, line in zip(rest[3:], lines[3:], strict=True)]
        assert weights == pytest.approx([weights[0]] * 3, rel=1e-3) and weights[0] > 0, "one for all of the stage"
        stressed = result.vertices[:, 0] > 0.2
        spared = result.vertices[:, 0] < -0.2
        relief = [np.abs(part.relief_mm) for part in (result, twin)]
        assert relief[0][stressed].mean() < 0.9 * relief[1][stressed].mean()
        assert relief[0][spared].mean() == pytest.approx(relief[1][spared].mean(), rel=0.05)
        assert "stress" not in result.metrics and "unconstrained" not in result.metrics

    def test_nothing_happens_where_relief_raises_no_stress(self, toy, two_views, twin, monkeypatch):
        monkeypatch.setattr(stress_stage, "by_solver", lambda *_: lambda shape: 2 - 0 * shape[:4, 0])
        result = genmf_mi.refine(toy, self.CONFIG, scene=two_views)
        assert {line["stage"] for line in result.history} == {1, 2}
        assert difference_mm(result, twin) < TOLERANCE_MM

    def test_by_finite_elements(self, toy, two_views):
        """The whole of it on a coarse mesh: the measures are near those of the initial part."""
        result = genmf_mi.refine(toy, replace(self.CONFIG, stress_every=2), scene=two_views)
        for name in ("stress_mean", "stress_band"):
            assert result.history[-1][name] == pytest.approx(1, abs=0.1)

    def test_by_the_network(self, toy, two_views, waves):
        config = replace(self.CONFIG, stress_every=2, stress_by="network")
        result = genmf_mi.refine(toy, config, scene=two_views)
        assert Waves.evaluations == 1 + 2
        assert result.history[-1]["stress_mean"] == pytest.approx(1, abs=0.05)

    def test_resumed_and_verified(self, toy, two_views, twin, pressing, tmp_path, monkeypatch):
        """After a crash in stage two it ends where the uninterrupted run does, and knows where it parted."""
        config = replace(self.CONFIG, stress_every=1)
        whole = genmf_mi.refine(toy, config, scene=two_views)
        with pytest.raises(RuntimeError):
            genmf_mi.refine(toy, config, out=tmp_path / "run", scene=two_views,
                            progress=Recorder(stop=5, error=RuntimeError))  # fmt: skip
        checkpoint = Checkpoint.load(tmp_path / "run" / CHECKPOINT)
        assert checkpoint.stress["gradient_norm_weight"] > 0
        assert checkpoint.iteration == 4 and checkpoint.stage_one.iteration == 3
        assert not torch.equal(checkpoint.parameters[0], checkpoint.stage_one.parameters[0])

        simulated, verify = {}, verification.verify
        monkeypatch.setattr(
            verification, "verify", lambda shapes, *a, **k: simulated.update(shapes) or verify(shapes, *a, **k)
        )
        resumed = genmf_mi.refine(toy, config, out=tmp_path / "run", scene=two_views, resume=True, verify=True)
        assert [line["stage"] for line in resumed.history] == [1, 1, 1, 2, 2, 2]
        assert difference_mm(resumed, whole) < TOLERANCE_MM
        metrics = json.loads((tmp_path / "run" / "metrics.json").read_text())
        stress = metrics["stress"]
        assert set(stress["shapes"]) == {"before", "unconstrained", "after"}
        assert set(stress["ratio"]) == {"unconstrained", "after", "constrained"} and "mean" in stress["remains"]
        apart = (resumed.vertices - twin.vertices) * 100 / np.ptp(twin.vertices, axis=0).max()
        assert np.abs(apart).max() > 10 * TOLERANCE_MM
        after, unconstrained = (simulated[name][0] for name in ("after", "unconstrained"))
        apart_simulated = (after - unconstrained) * 100 / np.ptp(unconstrained, axis=0).max()
        np.testing.assert_allclose(apart_simulated, apart, atol=TOLERANCE_MM)
        for name in ("lpips_alex", "ssim"):
            assert metrics["unconstrained"][name] == pytest.approx(twin.metrics["after"][name], abs=1e-3)
        assert set(metrics["unseen"]["unconstrained"]) == set(metrics["after"])
        text = (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
        assert "Thermal stress" in text and "Without stress stage" in text and "predicted stress, surface band" in text

    def test_no_stage_for_thin_walls(self, toy, two_views, twin, pressing, monkeypatch):
        """It says so, and gives the part without the stage."""
        monkeypatch.setattr("genmf_mi.sdf.distance.thin_fraction", lambda *surface: 0.2)
        recorder = Recorder()
        result = genmf_mi.refine(toy, self.CONFIG, scene=two_views, progress=recorder)
        assert any("20%" in warning for warning in recorder.warnings)
        assert not pressing and {line["stage"] for line in result.history} == {1}
        assert "20%" in result.metrics["stress_stage_left_out"]
        assert difference_mm(result, twin) < TOLERANCE_MM

    def test_some_shapes_alone(self, toy, two_views):
        """Nothing is simulated unasked, and without a stress stage there is nothing between before and after."""
        config = replace(CONFIG, iterations=1)
        one = genmf_mi.refine(toy, config, scene=two_views, verify=("after",)).metrics
        two = genmf_mi.refine(toy, config, scene=two_views, verify=True).metrics
        assert set(one["stress"]["shapes"]) == {"after"} and "ratio" not in one["stress"]
        assert set(two["stress"]["shapes"]) == {"before", "after"} and set(two["stress"]["ratio"]) == {"after"}
        means = [metrics["stress"]["shapes"]["after"]["von_mises_mpa"]["mean"] for metrics in (one, two)]
        assert means[0] == pytest.approx(means[1], rel=1e-3)

    def test_a_weight_of_zero_is_no_stage(self, toy, two_views, twin, pressing):
        """And costs nothing: no stress is predicted at all."""
        result = genmf_mi.refine(toy, replace(self.CONFIG, stress_weight=0.0), scene=two_views)
        assert not pressing and {line["stage"] for line in result.history} == {1}
        assert "stress_stage_left_out" not in result.metrics
        assert difference_mm(result, twin) < TOLERANCE_MM

    def test_size_and_material_reach_it(self, toy, two_views, monkeypatch, waves):
        """Prediction and verification are of the part that is printed, whichever predicts."""
        asked, verified = [], []
        body = stress_stage.FollowingBody

        def following(phi, frame, settings):
            asked.append((frame.size_mm, settings.material))
            return body(phi, frame, settings, nodes=500)

        monkeypatch.setattr(stress_stage, "FollowingBody", following)
        monkeypatch.setattr(
            verification, "verify", lambda shapes, frame, **k: verified.append((frame.size_mm, k)) or {}
        )
        config = replace(self.CONFIG, size_mm=50.0, max_relief_mm=0.5, material="petg", edge_mm=1.5, iterations=2)
        genmf_mi.refine(toy, config, scene=two_views, verify=("after",))
        genmf_mi.refine(toy, replace(config, stress_by="network"), scene=two_views)
        assert (Waves.asked.size_mm, Waves.asked.material) == (50.0, "petg")
        assert verified[0][0] == 50.0 and verified[0][1]["material"] == "petg"

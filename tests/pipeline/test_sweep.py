"""The sweep over the weight of the stress: which runs are made, how they are compared, and how it continues."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from PIL import Image

from genmf_mi.core.config import PRESETS, RefineConfig
from genmf_mi.core.errors import ConfigError
from genmf_mi.core.progress import Progress
from genmf_mi.pipeline import run_folder, sweep
from genmf_mi.pipeline.run_folder import CHECKPOINT, METRICS
from genmf_mi.report import tables
from genmf_mi.report.sweep import sweep_table

pytestmark = pytest.mark.usefixtures("workplace")

CONFIG = RefineConfig(iterations=7, score_vgg=False)


def summary(factor: float) -> dict:
    """Of a part under ``factor`` times the stress of the one before."""
    stress = {"mean": 0.3 + 0.1 * factor, "p99_9": 2.0 * factor}
    return {"von_mises_mpa": stress, "surface_band": {"mean": 0.5 * factor, "p99_9": 1.5}, "displacement_max_mm": 0.2}


def relief(config: RefineConfig) -> float:
    """How much of the relief is left."""
    return 1 / (1 + config.stress_weight)


class Refine:
    """Instead of refinements: LPIPS falls from 0.3 to 0.1 with the relief, and stress rises by 40 % with it."""

    def __init__(self) -> None:
        self.calls: list[tuple[str, RefineConfig, dict]] = []
        self.interrupt_at: str | None = None

    def __call__(self, asset, config, *, out, verify, force, resume, progress=None, **options) -> SimpleNamespace:
        self.calls.append((out.name, config, {"verify": verify, "resume": resume, **options}))
        out.mkdir(parents=True, exist_ok=True)
        (out / run_folder.CONFIG).write_text(yaml.safe_dump({"asset": "toy", **config.to_dict()}))
        (progress or Progress()).stage("refining")
        interrupted = out.name == self.interrupt_at
        shapes = {"before": summary(1), "after": summary(1 + 0.4 * relief(config))}
        metrics = {
            "asset": "toy",
            "before": {"lpips_alex": 0.3},
            "after": {"lpips_alex": 0.3 - 0.2 * relief(config)},
            "unseen": {"after": {"lpips_alex": 0.25}},
            "interrupted": interrupted,
            **({} if interrupted else {"stress": {"shapes": {name: shapes[name] for name in verify}}}),
        }
        (out / METRICS).write_text(json.dumps(metrics))
        (out / CHECKPOINT).touch() if interrupted else (out / CHECKPOINT).unlink(missing_ok=True)
        return SimpleNamespace(metrics=metrics)


@pytest.fixture
def runs(monkeypatch) -> Refine:
    stub = Refine()
    monkeypatch.setattr(sweep, "refine", stub)
    return stub


def names(runs: Refine) -> list[str]:
    made = [name for name, *_ in runs.calls]
    runs.calls.clear()
    return made


class TestRuns:
    def test_one_per_weight(self, runs) -> None:
        """In order, the one without the stress stage first, and the part before simulated once."""
        found = sweep.sweep("toy.glb", (3.0, 0.3), CONFIG, out=Path("out"), scene="my.xml")
        assert [name for name, *_ in runs.calls] == ["w0", "w0.3", "w3"]
        assert [config for _, config, _ in runs.calls] == [
            replace(CONFIG, stress=weight > 0, stress_weight=weight) for weight in (0.0, 0.3, 3.0)
        ]
        assert [options["verify"] for *_, options in runs.calls] == [("before", "after"), ("after",), ("after",)]
        assert all(options["scene"] == "my.xml" for *_, options in runs.calls)
        assert json.loads(Path("out/sweep.json").read_text(encoding="utf-8")) == found

    def test_a_preset_without_stress_is_no_obstacle(self, runs) -> None:
        sweep.sweep("toy.glb", (1.0,), PRESETS["draft"], out=Path("out"))
        assert [config.stress for _, config, _ in runs.calls] == [False, True]

    def test_finished_runs_are_taken_as_they_are(self, runs) -> None:
        first = sweep.sweep("toy.glb", (1.0,), CONFIG, out=Path("out"))
        assert names(runs) == ["w0", "w1"]
        again = sweep.sweep("toy.glb", (1.0, 3.0), replace(CONFIG, device="cpu"), out=Path("out"))
        assert names(runs) == ["w3"] and again["runs"][:2] == first["runs"]
        sweep.sweep("toy.glb", (1.0,), CONFIG, out=Path("out"), force=True)
        assert names(runs) == ["w0", "w1"]

    def test_interrupted_runs_are_resumed(self, runs) -> None:
        runs.interrupt_at = "w1"
        with pytest.raises(KeyboardInterrupt):
            sweep.sweep("toy.glb", (1.0, 3.0), CONFIG, out=Path("out"))
        assert names(runs) == ["w0", "w1"] and Path("out/w1", CHECKPOINT).exists()
        assert len(json.loads(Path("out/sweep.json").read_text(encoding="utf-8"))["runs"]) == 1
        runs.interrupt_at = None
        sweep.sweep("toy.glb", (1.0, 3.0), CONFIG, out=Path("out"))
        assert [(name, options["resume"]) for name, _, options in runs.calls] == [("w1", True), ("w3", False)]

    def test_a_run_that_was_not_simulated_is_made_anew(self, runs) -> None:
        sweep.sweep("toy.glb", (1.0,), CONFIG, out=Path("out"))
        names(runs)
        path = Path("out/w1/metrics.json")
        path.write_text(json.dumps({**json.loads(path.read_text()), "stress": {"shapes": {}}}))
        sweep.sweep("toy.glb", (1.0,), CONFIG, out=Path("out"))
        assert names(runs) == ["w1"]

    def test_other_settings_in_one_folder(self, runs) -> None:
        sweep.sweep("toy.glb", (1.0,), CONFIG, out=Path("out"))
        with pytest.raises(ConfigError, match="another iterations, size_mm"):
            sweep.sweep("toy.glb", (1.0,), replace(CONFIG, size_mm=80.0, iterations=8), out=Path("out"))

    @pytest.mark.parametrize("weights", [(-1.0,), (float("nan"),), (1.0, float("inf"))])
    def test_weights_that_are_none(self, runs, weights) -> None:
        with pytest.raises(ConfigError, match="weights of the stress"):
            sweep.sweep("toy.glb", weights, CONFIG, out=Path("out"))

    def test_a_method_without_stages(self, runs) -> None:
        with pytest.raises(ConfigError, match="--method relief"):
            sweep.sweep("toy.glb", (1.0,), replace(CONFIG, method="displacement"), out=Path("out"))
        assert not runs.calls

    def test_stages_name_the_weight(self, runs) -> None:
        class Stages(Progress):
            names: list[str] = []  # noqa: RUF012

            def stage(self, name: str) -> None:
                self.names.append(name)

        sweep.sweep("toy.glb", (0.3,), CONFIG, out=Path("out"), progress=Stages())
        assert len(Stages.names) == 2 and "0.3" in Stages.names[1] and "refining" in Stages.names[1]


class TestNumbers:
    @pytest.fixture
    def found(self, runs) -> dict:
        return sweep.sweep("toy.glb", (0.0, 1.0, 3.0), CONFIG, out=Path("out"))

    def test_by_hand(self, found) -> None:
        assert found["asset"] == "toy"
        before = {"p99_9": 2.0, "mean": 0.4, "surface_band_mean": 0.5, "surface_band_p99_9": 1.5}
        assert found["before"] == {"lpips_alex": 0.3, "stress": pytest.approx(before)}
        for run, left in zip(found["runs"], (1, 0.5, 0.25)):
            assert run["lpips_alex"] == pytest.approx(0.3 - 0.2 * left)
            assert run["kept_gain"] == pytest.approx(left)
            assert run["stress"]["p99_9"] == pytest.approx(2 + 0.8 * left)
            assert run["ratio"]["p99_9"] == run["ratio"]["surface_band_mean"] == pytest.approx((1 + 0.4 * left) / 1.4)
            assert run["ratio"]["mean"] == pytest.approx((0.4 + 0.04 * left) / 0.44)
            assert run["remains"]["surface_band_mean"] == pytest.approx(left)
            assert run["remains"]["surface_band_p99_9"] is None

    def test_table(self, found) -> None:
        cells = sweep_table(found)
        assert all(len(row) == len(cells.columns) for row in cells.rows)
        assert [row[0] for row in cells.rows] == ["before", "0", "1", "3"]
        assert cells.rows[2] == ["1", "0.2000", "50 %", "2.400 ×0.86", "0.420 ×0.95", "0.600 ×0.86", "50 %"]

    def test_picture(self, found) -> None:
        with Image.open("out/sweep.png") as picture:
            assert picture.width > 600 and np.asarray(picture.convert("L")).std() > 5

    def test_no_gain_to_keep(self) -> None:
        assert tables.kept_gain(0.3, 0.3, 0.2) is None
        assert tables.kept_gain(0.3, 0.1, 0.15) == pytest.approx(0.75)

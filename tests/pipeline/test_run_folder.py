"""The folder of a run: who may write into it, and what survives a crash."""

from __future__ import annotations

import errno
import json
import os
from dataclasses import asdict, replace
from pathlib import Path

import pytest
import torch
import yaml

from genmf_mi.core.config import PRESETS, RefineConfig, Weights
from genmf_mi.core.errors import ConfigError, OutputError
from genmf_mi.geometry.uniform_adam import UniformAdam
from genmf_mi.pipeline.checkpoint import Checkpoint
from genmf_mi.pipeline.run_folder import CHECKPOINT, CONFIG, HISTORY, METRICS, RunFolder

SETTINGS = RefineConfig(iterations=50, view_jitter=(10.0, 5.0), weights=Weights(grey_l1=0.3))


def started(
    folder: Path, config: RefineConfig = SETTINGS, asset: str = "toy", *, force=False, resume=False
) -> RunFolder:
    return RunFolder.open(folder, asset, config, force=force, resume=resume)


def lines(first: int, last: int) -> list[dict]:
    return [{"iteration": i, "loss": 1 / (i + 1)} for i in range(first, last)]


def state(iteration: int) -> Checkpoint:
    """As after so many iterations, in stage two."""
    parameter = torch.arange(6.0).view(2, 3).requires_grad_()
    optimiser = UniformAdam([parameter], 0.1)
    parameter.grad = torch.ones(2, 3)
    optimiser.step()
    stage_one = Checkpoint.of(10, (parameter,), optimiser, {})
    stress = {"gradient_norm_weight": 0.5, "penalty": {"calls": iteration, "tangent": {"value": torch.tensor(2.0)}}}
    return Checkpoint.of(iteration, (parameter * iteration,), optimiser, stress, stage_one)


def assert_same(one: Checkpoint, other: Checkpoint) -> None:
    """Every number and tensor of two checkpoints."""

    def flat(values) -> list:
        items = (
            values.values() if isinstance(values, dict) else values if isinstance(values, (tuple, list)) else [values]
        )
        return [x for v in items for x in (flat(v) if isinstance(v, (dict, tuple, list)) else [v])]

    for a, b in zip(flat(asdict(one)), flat(asdict(other)), strict=True):
        assert torch.equal(a, b) if torch.is_tensor(a) else a == b
    assert (one.stage_one is None) == (other.stage_one is None)


def interrupted(folder: Path, iteration: int = 25) -> RunFolder:
    run = started(folder)
    run.save(state(iteration), lines(0, iteration))
    return run


def finished(folder: Path) -> RunFolder:
    run = interrupted(folder)
    run.finish({"after": {"ssim": 0.9}, "interrupted": False})
    return run


def stopped(folder: Path) -> RunFolder:
    """By Ctrl-C: what there is was written, and the run can go on."""
    run = interrupted(folder)
    run.finish({"after": {"ssim": 0.8}, "interrupted": True})
    return run


def failed(folder: Path) -> RunFolder:
    """Before its first checkpoint, for want of a texture say."""
    return started(folder)


class TestOpen:
    def test_settings_are_there_from_the_start(self, tmp_path):
        run = started(tmp_path / "deep" / "er")
        written = yaml.safe_load((tmp_path / "deep" / "er" / CONFIG).read_text())
        assert written == run.settings() == {"asset": "toy", **SETTINGS.to_dict(), "inputs": {}}
        assert os.listdir(run.path) == [CONFIG]

    @pytest.mark.parametrize(
        ("before", "message"),
        [(finished, "a finished run.*--force"), (interrupted, "an interrupted run.*--resume.*--force"),
         (stopped, "an interrupted run.*--resume.*--force")],
    )  # fmt: skip
    def test_a_run_is_not_overwritten(self, tmp_path, before, message):
        before(tmp_path)
        contents = {name: (tmp_path / name).read_bytes() for name in os.listdir(tmp_path)}
        with pytest.raises(OutputError, match=message):
            started(tmp_path)
        assert {name: (tmp_path / name).read_bytes() for name in os.listdir(tmp_path)} == contents

    @pytest.mark.parametrize(
        "name", ["refined.glb", "refined.stl", "report.html", "metrics.json", "config.yaml", "stop"]
    )
    @pytest.mark.parametrize("force", [False, True])
    def test_files_of_somebody_else_are_never_replaced(self, tmp_path, name, force):
        """However they are called: without the settings of a run beside them they are not ours."""
        (tmp_path / name).write_text("mine: not a run's")
        with pytest.raises(OutputError, match=f"{name}, which no run has left there"):
            started(tmp_path, force=force)
        assert (tmp_path / name).read_text() == "mine: not a run's" and os.listdir(tmp_path) == [name]

    def test_what_a_killed_process_left_is_swept(self, tmp_path):
        failed(tmp_path)
        for name in (".refined-abcd1234.3mf", ".metrics-00000000.json", ".refined-note.txt"):
            (tmp_path / name).touch()
        started(tmp_path, force=True)
        assert set(os.listdir(tmp_path)) == {CONFIG, ".refined-note.txt"}

    def test_with_force_it_is(self, tmp_path):
        """Whatever could be taken for the new run's is gone; other files stay."""
        failed(tmp_path)
        (tmp_path / "note.txt").write_text("mine")
        started(tmp_path, replace(SETTINGS, iterations=7), force=True)
        assert set(os.listdir(tmp_path)) == {CONFIG, "note.txt"}
        assert RunFolder(tmp_path).settings()["iterations"] == 7

    def test_a_run_that_failed_early_may_be_tried_again(self, tmp_path):
        failed(tmp_path)
        assert started(tmp_path, replace(SETTINGS, iterations=8)).settings()["iterations"] == 8

    @pytest.mark.parametrize("before", [interrupted, stopped])
    def test_resume(self, tmp_path, before):
        before(tmp_path)
        run = started(tmp_path, resume=True)
        loaded, history = run.load()
        assert loaded.iteration == 25
        assert_same(loaded, state(25))
        assert history == lines(0, 25)

    def test_another_device_may_resume(self, tmp_path):
        interrupted(tmp_path)
        started(tmp_path, replace(SETTINGS, device="cpu"), resume=True)

    @pytest.mark.parametrize("before", [finished, failed, None])
    def test_nothing_to_resume(self, tmp_path, before):
        if before:
            before(tmp_path)
        with pytest.raises(OutputError, match=r"no interrupted run.*without --resume"):
            started(tmp_path, resume=True)

    @pytest.mark.parametrize(
        ("change", "named"),
        [({"iterations": 51}, "iterations"), ({"weights": Weights()}, "weights"), ({"seed": 1}, "seed"),
         ({"view_jitter": (10.0, 6.0)}, "view_jitter"), ({"size_mm": 90.0, "edge_mm": 1.0}, "edge_mm, size_mm")],
    )  # fmt: skip
    def test_resume_with_other_settings_is_refused_by_name(self, tmp_path, change, named):
        interrupted(tmp_path)
        with pytest.raises(ConfigError, match=f"another {named}\\."):
            started(tmp_path, replace(SETTINGS, **change), resume=True)

    def test_resume_with_another_asset_is_refused(self, tmp_path):
        interrupted(tmp_path)
        with pytest.raises(ConfigError, match="another asset"):
            started(tmp_path, asset="other", resume=True)

    @pytest.mark.parametrize("text", ["", "a list", "- 1", "{unclosed", "\x00"])
    def test_resume_with_damaged_settings(self, tmp_path, text):
        interrupted(tmp_path)
        (tmp_path / CONFIG).write_text(text)
        with pytest.raises(OutputError, match="--force"):
            started(tmp_path, resume=True)

    @pytest.mark.parametrize("force", [False, True])
    def test_where_nothing_can_be_written(self, tmp_path, force):
        (tmp_path / "file").touch()
        for folder in (tmp_path / "file", tmp_path / "file" / "below"):
            with pytest.raises(OutputError, match=r"cannot (read|write)"):
                started(folder, force=force)

    def test_a_request_to_stop_counts_for_one_run_and_is_nobody_elses_file(self, tmp_path):
        (tmp_path / "stop").write_text("mine")
        with pytest.raises(OutputError, match="stop"):
            started(tmp_path)
        assert (tmp_path / "stop").read_text() == "mine"
        run = started(tmp_path / "run")
        run.save(state(1), lines(0, 1))
        (run.path / "stop").touch()
        assert run.stop_requested and not started(run.path, resume=True).stop_requested

    @pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
    def test_without_permission(self, tmp_path):
        for mode in (0o500, 0o000):
            tmp_path.chmod(mode)
            with pytest.raises(OutputError, match=r"cannot (read|write)"):
                started(tmp_path / "run")
            tmp_path.chmod(0o700)


class TestSave:
    def test_a_line_per_iteration(self, tmp_path):
        run = started(tmp_path)
        for count in (2, 5):
            run.save(state(count), lines(0, count))
            assert [json.loads(x) for x in (tmp_path / HISTORY).read_text().splitlines()] == lines(0, count)
            assert run.load()[0].iteration == count
        assert set(os.listdir(tmp_path)) == {CONFIG, HISTORY, CHECKPOINT}

    def test_crash_between_the_two_files(self, tmp_path, monkeypatch):
        """The checkpoint is older than the history: the run goes on from the checkpoint."""
        run = interrupted(tmp_path)

        def stop(*_, **__):
            raise KeyboardInterrupt

        with monkeypatch.context() as patch:
            patch.setattr(torch, "save", stop)
            with pytest.raises(KeyboardInterrupt):
                run.save(state(30), lines(0, 30))
        loaded, history = run.load()
        assert loaded.iteration == 25 and history == lines(0, 25)
        run.save(state(28), lines(0, 28))
        assert run.load()[1] == lines(0, 28)

    def test_disk_full(self, tmp_path, monkeypatch):
        """The last good checkpoint survives, and no temporary file stays."""
        run = interrupted(tmp_path)

        def full(state, file):
            file.write(b"half")
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        monkeypatch.setattr(torch, "save", full)
        with pytest.raises(OutputError, match="No space left"):
            run.save(state(30), lines(0, 30))
        assert set(os.listdir(tmp_path)) == {CONFIG, HISTORY, CHECKPOINT}
        assert run.load()[0].iteration == 25

    def test_folder_gone(self, tmp_path):
        """Somebody tidied up: it is made again. Somebody put a file there: that is said."""
        RunFolder(tmp_path / "gone").save(state(1), lines(0, 1))
        assert set(os.listdir(tmp_path / "gone")) == {HISTORY, CHECKPOINT}
        (tmp_path / "file").touch()
        with pytest.raises(OutputError, match=r"cannot (read|write)"):
            RunFolder(tmp_path / "file").save(state(1), lines(0, 1))


class TestLoad:
    @pytest.mark.parametrize(
        "damage",
        [lambda data: b"", lambda data: b"not a zip", lambda data: data[:100], lambda data: data[:-30],
         lambda data: data[:-400] + bytes(300) + data[-100:]],
    )  # fmt: skip
    def test_damaged_checkpoint(self, tmp_path, damage):
        run = interrupted(tmp_path)
        path = tmp_path / CHECKPOINT
        path.write_bytes(damage(path.read_bytes()))
        with pytest.raises(OutputError, match=r"damaged.*--force"):
            run.load()

    def test_checkpoint_of_something_else(self, tmp_path):
        run = interrupted(tmp_path)
        for other in ({"weights": torch.zeros(3)}, torch.zeros(3), {**asdict(state(3)), "iteration": "three"}):
            torch.save(other, tmp_path / CHECKPOINT)
            with pytest.raises(OutputError, match="damaged"):
                run.load()

    def test_checkpoint_with_code(self, tmp_path):
        """A file from elsewhere is read without running what it may hold."""
        run = interrupted(tmp_path)
        torch.save({**asdict(state(3)), "stress": Path("x")}, tmp_path / CHECKPOINT)
        with pytest.raises(OutputError, match="damaged"):
            run.load()

    @pytest.mark.parametrize("text", [None, "", "not json\n" * 25, '{"loss": 1}\n' * 25, "[]\n" * 25])
    def test_history_that_does_not_fit(self, tmp_path, text):
        run = interrupted(tmp_path)
        (tmp_path / HISTORY).unlink() if text is None else (tmp_path / HISTORY).write_text(text)
        with pytest.raises(OutputError, match="--force"):
            run.load()

    @pytest.mark.parametrize("text", ["", "[]", "{", "[" * 100_000, "\x00"])
    def test_damaged_metrics(self, tmp_path, text):
        run = finished(tmp_path)
        (tmp_path / METRICS).write_text(text)
        with pytest.raises(OutputError, match=r"metrics\.json.*--force"):
            run.metrics()

    @pytest.mark.parametrize(
        "moment", [{}, {"first": torch.zeros(2)}, {"second": torch.full((5, 3), torch.nan)}, {"step": "x"}]
    )
    def test_damaged_optimiser(self, moment):
        """Of another shape, not numbers, or not there: refused before an iteration is made with it."""
        parameter = torch.zeros(5, 3)
        optimiser = UniformAdam((parameter,), 0.1)
        state = optimiser.state_dict()["moments"][0]
        optimiser.load_state_dict({"moments": [dict(state)]})
        for broken in ({"moments": [state | moment if moment else {}]}, {"moments": []}, {}):
            with pytest.raises(ValueError, match=r"no state|zip"):
                optimiser.load_state_dict(broken)


class TestFinish:
    def test_complete(self, tmp_path):
        finished(tmp_path)
        assert set(os.listdir(tmp_path)) == {CONFIG, HISTORY, METRICS}
        assert json.loads((tmp_path / METRICS).read_text())["after"] == {"ssim": 0.9}

    def test_interrupted(self, tmp_path):
        """Metrics of the part so far, and the means to go on."""
        stopped(tmp_path)
        assert set(os.listdir(tmp_path)) == {CONFIG, HISTORY, METRICS, CHECKPOINT}


class TestSettings:
    @pytest.mark.parametrize("config", [*PRESETS.values(), SETTINGS], ids=[*PRESETS, "own"])
    def test_plain_types_only(self, config):
        assert yaml.safe_load(yaml.safe_dump(config.to_dict())) == config.to_dict()

    def test_a_weight_of_zero_is_no_stress_stage(self):
        assert RefineConfig().stress_stage
        assert not RefineConfig(stress_weight=0.0).stress_stage and not RefineConfig(stress=False).stress_stage

    @pytest.mark.parametrize(
        ("setting", "value"),
        [("size_mm", 0.0), ("size_mm", -5.0), ("size_mm", float("nan")), ("size_mm", float("inf")),
         ("max_relief_mm", -0.1), ("max_relief_mm", 20.0), ("nozzle_mm", 0.0), ("edge_mm", -1.0), ("iterations", -1),
         ("resolution", 32), ("samples", 0), ("max_faces", 10), ("learning_rate", 0.0), ("learning_rate", float("nan")),
         ("smoothing", -1.0), ("gradient_floor", -1.0), ("view_jitter", (-1.0, 0.0)), ("light_jitter", -1.0),
         ("stage_one_share", 1.5)],
    )  # fmt: skip
    def test_out_of_range(self, setting, value):
        """The message names the setting as the command line spells it."""
        with pytest.raises(ConfigError, match=setting.replace("_", "-")):
            replace(RefineConfig(), **{setting: value})

    def test_negative_weight(self):
        with pytest.raises(ConfigError, match="grey-l1"):
            Weights(grey_l1=-1.0)

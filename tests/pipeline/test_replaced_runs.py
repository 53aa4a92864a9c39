"""A run that replaces another one: the old one is whole until the new one is complete, whatever comes in between."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path

import pytest
from test_run_folder import SETTINGS, failed, finished, interrupted, lines, started, state, stopped

from genmf_mi.core.errors import ConfigError, OutputError
from genmf_mi.pipeline.run_folder import (
    CHECKPOINT,
    COMPLETE,
    CONFIG,
    CONTENTS,
    FILES,
    HISTORY,
    METRICS,
    PREVIEW,
    REPLACEMENT,
    RunFolder,
)  # fmt: skip

SHORTER = replace(SETTINGS, iterations=7)
WHOLE = {"after": {"ssim": 0.95}, "interrupted": False}


def contents(folder: Path) -> dict[str, bytes]:
    """All files but those of a replacement."""
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


def grown(folder: Path) -> RunFolder:
    """A replacement after its last iteration, with a file that the old run lacks."""
    run = started(folder, SHORTER, force=True)
    run.save(state(7), lines(0, 7))
    (run.path / "refined.stl").write_text("new")
    (run.path / "exr" / "after").mkdir(parents=True)
    (run.path / "exr" / "after" / "0.exr").write_text("new")
    (run.path / PREVIEW).touch()
    return run


@pytest.mark.parametrize("before", [finished, interrupted, stopped])
class TestReplaced:
    def test_the_old_run_stays_until_the_end(self, tmp_path, before):
        before(tmp_path)
        for name in ("refined.glb", "note.txt"):
            (tmp_path / name).write_text("old")
        kept = contents(tmp_path)
        run = grown(tmp_path)
        assert contents(tmp_path) == kept and run.home(interrupted=True) == run.path == tmp_path / REPLACEMENT
        run.finish(WHOLE)
        assert run.home(interrupted=False) == tmp_path
        assert set(os.listdir(tmp_path)) == {CONFIG, HISTORY, METRICS, "refined.stl", "exr", "note.txt"}
        assert (tmp_path / "note.txt").read_text() == "old" and (tmp_path / "exr" / "after" / "0.exr").exists()
        assert RunFolder(tmp_path).metrics() == WHOLE and RunFolder(tmp_path).settings()["iterations"] == 7

    def test_killed_before_its_first_checkpoint(self, tmp_path, before):
        """Nothing has happened: what there was can be resumed or replaced as before."""
        before(tmp_path)
        kept = contents(tmp_path)
        started(tmp_path, SHORTER, force=True)
        assert contents(tmp_path) == kept
        if before is finished:
            with pytest.raises(OutputError, match="a finished run"):
                started(tmp_path)
            with pytest.raises(OutputError, match="no interrupted run"):
                started(tmp_path, resume=True)
        else:
            assert started(tmp_path, resume=True).load()[0].iteration == 25
        assert contents(tmp_path) == kept and not (tmp_path / REPLACEMENT).exists()

    def test_interrupted_and_resumed(self, tmp_path, before):
        before(tmp_path)
        kept = contents(tmp_path)
        grown(tmp_path).finish({"interrupted": True})
        assert contents(tmp_path) == kept
        assert RunFolder(tmp_path).interrupted and RunFolder(tmp_path).metrics() is None
        with pytest.raises(OutputError, match=r"that was to replace it.*--resume.*--force"):
            started(tmp_path)
        with pytest.raises(ConfigError, match="another iterations"):
            started(tmp_path, resume=True)
        run = started(tmp_path, SHORTER, resume=True)
        assert run.load()[0].iteration == 7
        run.finish(WHOLE)
        assert RunFolder(tmp_path).metrics() == WHOLE and not RunFolder(tmp_path).interrupted

    def test_interrupted_and_started_again(self, tmp_path, before):
        before(tmp_path)
        kept = contents(tmp_path)
        grown(tmp_path).finish({"interrupted": True})
        run = started(tmp_path, replace(SETTINGS, iterations=9), force=True)
        assert contents(tmp_path) == kept and os.listdir(run.path) == [CONFIG]

    def test_killed_at_every_step_of_the_exchange(self, tmp_path, before, monkeypatch):
        """The old run whole, or the new one: the next to look brings it to its end."""
        steps = 0
        while True:
            folder = tmp_path / str(steps)
            folder.mkdir()
            before(folder)
            (folder / "refined.glb").write_text("old")
            run, kept, left = grown(folder), contents(folder), [steps]

            def counted(original, left=left):
                def step(*arguments, **options):
                    if left[0] == 0:
                        raise KeyboardInterrupt
                    left[0] -= 1
                    return original(*arguments, **options)

                return step

            with monkeypatch.context() as patch:
                for name in ("rename", "replace", "unlink"):
                    patch.setattr(Path, name, counted(getattr(Path, name)))
                patch.setattr(os, "replace", counted(os.replace))
                try:
                    run.finish(WHOLE)
                    return
                except KeyboardInterrupt:
                    pass
            if (folder / COMPLETE).exists():
                assert RunFolder(folder).metrics() == WHOLE
            if RunFolder(folder).metrics() == WHOLE:
                assert set(os.listdir(folder)) <= {CONFIG, HISTORY, METRICS, "refined.stl", "exr", COMPLETE}
            else:
                assert contents(folder) == kept
            steps += 1
            assert steps < 60


class TestStrangers:
    def test_files_of_somebody_else_in_a_replacement_stay(self, tmp_path):
        finished(tmp_path)
        (tmp_path / REPLACEMENT).mkdir()
        (tmp_path / REPLACEMENT / "mine").write_text("mine")
        grown(tmp_path).finish({"interrupted": True})
        started(tmp_path, SHORTER, force=True)
        assert (tmp_path / REPLACEMENT / "mine").read_text() == "mine"

    @pytest.mark.parametrize(
        "listed", ["{", "[1]", "[[]]", '["../precious"]', '["exr/../../precious"]', '["/precious"]']
    )
    def test_a_list_that_names_other_files_moves_none(self, tmp_path, listed):
        run = finished(tmp_path / "run")
        (tmp_path / "precious").write_text("mine")
        (run.path / COMPLETE).mkdir()
        (run.path / COMPLETE / CONTENTS).write_text(listed)
        with pytest.raises(OutputError, match="Delete"):
            run.metrics()
        assert (tmp_path / "precious").read_text() == "mine"

    def test_a_run_that_failed_early_has_nothing_to_keep(self, tmp_path):
        failed(tmp_path)
        assert started(tmp_path, SHORTER, force=True).path == tmp_path
        assert json.loads(json.dumps(sorted(set(os.listdir(tmp_path)) & set(FILES)))) == [CONFIG]
        assert CHECKPOINT not in os.listdir(tmp_path)

"""What strikes a run at any of its steps costs the iterations since the last checkpoint at most.

A run is struck, then looked at and resumed; it must end as an undisturbed one. The exchange of a run that is replaced
is struck at every step in ``test_replaced_runs.py``, and real processes in ``test_fault_signals.py``.
"""

from __future__ import annotations

import errno
import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
import trimesh
from fault_runs import SMALL, failing_at, killed_at, make_small
from toys import painted

from genmf_mi.cli import main as cli
from genmf_mi.cli.progress import TerminalProgress
from genmf_mi.pipeline.run_folder import CHECKPOINT, COMPLETE, CONFIG, HISTORY, METRICS, REPLACEMENT, RunFolder

pytestmark = pytest.mark.usefixtures("lpips_weights")

TOLERANCE = 2e-3
RESULTS = {"refined.3mf", "refined.stl", "refined.glb", "before_after.png", "report.html", METRICS, CONFIG, HISTORY}
KILLED = [(CONFIG, 1, 0), (CHECKPOINT, 1, 0), (CHECKPOINT, 2, 2), ("refined.3mf", 1, 4), (METRICS, 1, 4)]
"""The file before whose final name the run is killed, the how many-eth one, and the iterations that are kept."""
FULL = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
READ_ONLY = OSError(errno.EROFS, os.strerror(errno.EROFS))


@pytest.fixture(autouse=True, scope="module")
def _small():
    with pytest.MonkeyPatch.context() as patch:
        make_small(patch)
        yield


@pytest.fixture(scope="module")
def asset(tmp_path_factory) -> str:
    return painted(tmp_path_factory.mktemp("asset") / "toy.ply")


@pytest.fixture(scope="module")
def run(asset, two_views):
    """Starts the run in a folder, as from the command line; returns the exit code."""
    return lambda out, *more: cli.main(["refine", asset, "--out", str(out), "--scene", str(two_views), *SMALL, *more])


@pytest.fixture(scope="module")
def undisturbed(run, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("undisturbed") / "run"
    assert run(out) == 0
    return out


def shape(folder: Path) -> np.ndarray:
    """Corners of the print file, in mm."""
    return np.asarray(trimesh.load(folder / "refined.stl", process=False).triangles)


def whole_files(folder: Path) -> None:
    """That no file under its final name is a half one."""
    for name in os.listdir(folder):
        path = folder / name
        if name in (METRICS, "contents.json"):
            json.loads(path.read_text())
        elif name == HISTORY:
            assert [json.loads(line)["iteration"] for line in path.read_text().splitlines()]
        elif name == CHECKPOINT:
            RunFolder(folder).load()
        elif name.startswith("refined."):
            assert trimesh.load(path, force="mesh").is_watertight
        elif name == CONFIG:
            RunFolder(folder).settings()
        elif name == "report.html":
            assert path.read_text().rstrip().endswith("</html>")


def assert_as_undisturbed(folder: Path, undisturbed: Path) -> None:
    assert set(os.listdir(folder)) == RESULTS == set(os.listdir(undisturbed))
    assert np.abs(shape(folder) - shape(undisturbed)).max() < TOLERANCE
    metrics = RunFolder(folder).metrics()
    assert metrics is not None and metrics["iterations"] == 4
    assert all(Path(path).is_file() for path in metrics["files"].values())


def go_on(run, folder: Path) -> int:
    """As the messages say: with --resume if there is a checkpoint, else once more. The iterations that were kept."""
    kept = RunFolder(folder).load()[0].iteration if (folder / CHECKPOINT).exists() else 0
    assert run(folder, *(["--resume"] if RunFolder(folder).interrupted else [])) == 0
    return kept


@pytest.mark.parametrize(("file", "count", "iterations"), KILLED, ids=lambda value: str(value))
def test_killed(run, undisturbed, tmp_path, file, count, iterations):
    with killed_at(file, count):
        run(tmp_path / "run")
    whole_files(tmp_path / "run")
    assert go_on(run, tmp_path / "run") == iterations
    assert_as_undisturbed(tmp_path / "run", undisturbed)


@pytest.mark.parametrize(("file", "error"), [(CHECKPOINT, FULL), ("refined.glb", READ_ONLY), (METRICS, FULL)])
def test_nothing_can_be_written(run, undisturbed, tmp_path, capsys, file, error):
    """On the second checkpoint, on the last files: the message says how to go on."""
    with failing_at(file, error, count=2 if file == CHECKPOINT else 1):
        assert run(tmp_path / "run") == 2
    line = capsys.readouterr().err.strip()
    assert file in line and str(error.strerror) in line and line.endswith("Then continue with --resume.")
    whole_files(tmp_path / "run")
    assert not [name for name in os.listdir(tmp_path / "run") if name.startswith(".")]
    assert go_on(run, tmp_path / "run") == (2 if file == CHECKPOINT else 4)
    assert_as_undisturbed(tmp_path / "run", undisturbed)


def at(patch: pytest.MonkeyPatch, what: object, do) -> None:
    """Call ``do`` when the progress comes to a stage, or to a number of iterations."""
    original = {name: getattr(TerminalProgress, name) for name in ("stage", "advance")}

    def patched(name):
        def call(self, first, *rest):
            original[name](self, first, *rest)
            if first == what:
                do()

        return call

    for name in original:
        patch.setattr(TerminalProgress, name, patched(name))


def test_the_folder_is_deleted(run, undisturbed, tmp_path, monkeypatch):
    with monkeypatch.context() as patch:
        at(patch, 3, lambda: shutil.rmtree(tmp_path / "run"))
        assert run(tmp_path / "run") == 0
    assert_as_undisturbed(tmp_path / "run", undisturbed)


def test_a_second_run_into_the_same_folder(run, undisturbed, tmp_path, monkeypatch, capsys):
    codes = []
    with monkeypatch.context() as patch:
        at(patch, 3, lambda: codes.append(run(tmp_path / "run", "--force")))
        assert run(tmp_path / "run") == 0
    assert codes == [2] and "another run is writing" in capsys.readouterr().err
    assert_as_undisturbed(tmp_path / "run", undisturbed)


def stop() -> None:
    raise KeyboardInterrupt


class TestCtrlC:
    def test_twice(self, run, undisturbed, tmp_path, monkeypatch, capsys):
        """While it iterates and while it finishes what there is: that is left out, and the state is kept."""
        with monkeypatch.context() as patch:
            at(patch, 3, stop)
            at(patch, "scoring", stop)
            assert run(tmp_path / "run") == cli.INTERRUPTED
        assert capsys.readouterr().err.splitlines() == ["continue with --resume", "interrupted"]
        whole_files(tmp_path / "run")
        assert go_on(run, tmp_path / "run") == 3
        assert_as_undisturbed(tmp_path / "run", undisturbed)

    def test_before_there_is_anything(self, run, tmp_path, monkeypatch, capsys):
        at(monkeypatch, "meshing", stop)
        assert run(tmp_path / "run") == cli.INTERRUPTED
        assert "start again" in capsys.readouterr().err and os.listdir(tmp_path / "run") == [CONFIG]


class TestReplaced:
    @pytest.fixture
    def old(self, undisturbed, tmp_path) -> Path:
        """A finished run, to be replaced by the same with another seed."""
        shutil.copytree(undisturbed, tmp_path / "run")
        return tmp_path / "run"

    @pytest.mark.parametrize("file", [CHECKPOINT, "refined.stl", COMPLETE])
    def test_killed(self, run, old, undisturbed, file):
        """The old run is whole; the new one goes on."""
        before = {path.name: path.read_bytes() for path in old.iterdir()}
        with killed_at(file, 1 if file != CHECKPOINT else 2):
            run(old, "--force", "--seed", "1")
        found = {path.name: path.read_bytes() for path in old.iterdir() if path.is_file() and path.name[0] != "."}
        assert found == before
        whole_files(old / REPLACEMENT)
        assert run(old, "--resume", "--seed", "1") == 0
        assert set(os.listdir(old)) == RESULTS
        assert np.abs(shape(old) - shape(undisturbed)).max() > 10 * TOLERANCE

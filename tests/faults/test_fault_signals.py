"""Real processes and real signals: killed, told to end, interrupted once and twice; then resumed to the end."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from fault_runs import HERE, SMALL, make_small
from test_faults import assert_as_undisturbed, asset, run, shape, undisturbed, whole_files  # noqa: F401

from genmf_mi.losses import lpips_weights as weights
from genmf_mi.pipeline.run_folder import CHECKPOINT, METRICS, RunFolder

pytestmark = [
    pytest.mark.usefixtures("lpips_weights"),
    pytest.mark.skipif(bool(weights.missing()), reason="a process has no LPIPS weights but those that are installed"),
]


@pytest.fixture(autouse=True, scope="module")
def _small():
    with pytest.MonkeyPatch.context() as patch:
        make_small(patch)
        yield


def struck(stops: str, signals: list[int], arguments: list[str]) -> tuple[int, str]:
    """A process that gets the next of ``signals`` at each of its ``stops``; its exit code and what it wrote."""
    process = subprocess.Popen(
        [sys.executable, str(HERE / "fault_runs.py"), stops, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout
    for number in signals:
        line = process.stdout.readline()
        assert line.startswith("at "), line + process.communicate()[1]
        process.send_signal(number)
    _, errors = process.communicate(timeout=120)
    return process.returncode, errors


def test_signals(asset, two_views, run, undisturbed, tmp_path):  # noqa: F811
    """One run that is killed, told to end, interrupted twice and once, and resumed each time."""
    out = tmp_path / "run"
    arguments = [asset, "--out", str(out), "--scene", str(two_views), *SMALL]

    code, _ = struck("3", [signal.SIGKILL], arguments)
    assert code == -signal.SIGKILL
    whole_files(out)
    assert RunFolder(out).load()[0].iteration == 2

    code, errors = struck("3", [signal.SIGTERM], [*arguments, "--resume"])
    assert (code, errors.splitlines()) == (143, ["continue with --resume"])
    whole_files(out)
    assert RunFolder(out).load()[0].iteration == 3

    code, errors = struck("4|scoring", [signal.SIGINT] * 2, [*arguments, "--resume"])
    assert (code, errors.splitlines()) == (130, ["continue with --resume", "interrupted"])
    assert {CHECKPOINT} <= set(os.listdir(out)) and METRICS not in os.listdir(out)
    assert not [name for name in os.listdir(Path(out)) if name.startswith(".")]

    assert run(out, "--resume") == 0
    assert_as_undisturbed(out, undisturbed)
    assert shape(out).shape == shape(undisturbed).shape

"""``genmf-mi sweep``: what reaches the sweep, and what is printed at its end."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest

from genmf_mi.cli import main as cli
from genmf_mi.core.config import PRESETS
from genmf_mi.core.progress import Progress
from genmf_mi.pipeline import sweep
from genmf_mi.report import sweep as report
from genmf_mi.report.tables import TextTable

pytestmark = pytest.mark.usefixtures("workplace")


@pytest.fixture
def calls(monkeypatch) -> list[tuple]:
    """Instead of a sweep."""
    calls = []

    def fake(asset, weights, config, *, progress: Progress, **options) -> dict:
        progress.stage("stress weight 0: loading")
        progress.advance(1, 3, {"loss": 0.1})
        calls.append((asset, weights, config, options))
        return {"asset": "toy"}

    monkeypatch.setattr(sweep, "sweep", fake)
    monkeypatch.setattr(report, "sweep_table", lambda result: TextTable(["weight", "LPIPS"], [["0", "0.1234"]]))
    return calls


def test_whole(calls, capsys) -> None:
    """Settings of a refinement come in one text; the table and the files are printed."""
    settings = "--arguments=--preset draft --size-mm 80 --scene 'a b.xml' --reference a.png@0,10"
    assert cli.main(["sweep", "toy.glb", "--stress-weight", "0,2", settings, "--force"]) == 0
    ((asset, weights, config, options),) = calls
    assert (asset, weights, config) == ("toy.glb", (0.0, 2.0), replace(PRESETS["draft"], size_mm=80.0))
    assert options == {"out": Path("runs/toy-sweep"), "force": True, "textured": None, "up": None,
                       "files_anywhere": False,
                       "scene": Path("a b.xml"),
                       "references": ("a.png@0,10",), "save_exr": False}  # fmt: skip
    captured = capsys.readouterr()
    text = re.sub(r"\s+", " ", captured.out)
    assert "toy: appearance" in text and "0.1234" in text and captured.err == ""
    assert "runs/toy-sweep/sweep.json" in text and "runs/toy-sweep/sweep.png" in text


def test_weights_by_default(calls) -> None:
    assert cli.main(["sweep", "toy.glb"]) == 0
    assert calls[0][1] == (0.0, 0.3, 1.0, 3.0, 10.0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--stress-weight", "much"], "numbers such as 0,1,3, not 'much'"),
        (["--arguments=--out here"], "give the first two to the sweep itself"),
        (["--arguments='"], "Close the quotes"),
    ],
)
def test_what_cannot_be_understood(calls, capsys, arguments, message) -> None:
    assert cli.main(["sweep", "toy.glb", *arguments]) == 2
    assert message in capsys.readouterr().err
    assert not calls


def test_weights_out_of_range(capsys) -> None:
    assert cli.main(["sweep", "toy.glb", "--stress-weight", "0,-1"]) == 2
    assert "cannot be negative" in capsys.readouterr().err


def test_ctrl_c(monkeypatch, capsys) -> None:
    def interrupted(*_, **__) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(sweep, "sweep", interrupted)
    assert cli.main(["sweep", "toy.glb", "--stress-weight", "1"]) == cli.INTERRUPTED
    assert capsys.readouterr().err == "interrupted\n"

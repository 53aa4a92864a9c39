"""The line in the terminal while work goes on."""

from __future__ import annotations

import io
import re

import pytest
from rich.console import Console

from genmf_mi.cli import progress
from genmf_mi.cli.progress import TerminalProgress
from genmf_mi.core.progress import PrefixedProgress


@pytest.fixture
def console() -> Console:
    return Console(file=io.StringIO(), force_terminal=True, color_system=None, width=120)


def shown(console: Console) -> list[str]:
    """The lines that were drawn, without what moves the cursor."""
    return [line.strip() for line in re.split(r"[\r\n]", re.sub(r"\x1b\[[?\d;]*\w", "", console.file.getvalue()))]


def drawn(terminal: TerminalProgress, console: Console) -> str:
    """The line as it is now."""
    terminal._display.refresh()
    return shown(console)[-1]


def test_stages_and_values(console):
    with TerminalProgress(shown=("loss", "ssim"), console=console) as terminal:
        terminal.stage("meshing")
        assert "meshing" in drawn(terminal, console)
        terminal.stage("refining")
        terminal.advance(3, 250, {"ssim": 0.00123, "loss": 1.5, "teacher": 9.0})
        line = drawn(terminal, console)
        assert "refining  loss 1.500  ssim 0.001230" in line and "3/250" in line and "teacher" not in line
        PrefixedProgress(terminal, "weight 3: ").stage("loading")
        line = drawn(terminal, console)
        assert "weight 3: loading" in line and "250" not in line and "ssim" not in line
    assert shown(console)[-1] == "", "nothing stays behind"


def test_shares_and_all_values(console):
    with TerminalProgress(console=console) as terminal:
        terminal.advance(0.3, 1.0)
        assert "30%" in drawn(terminal, console)
        terminal.advance(0.5, 1.0, {"loss": 2.0, "[bold]": 1.0})
        assert "loss 2.000  [bold] 1.000" in drawn(terminal, console)


def test_time_left(console, monkeypatch):
    now = [100.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    with TerminalProgress(console=console) as terminal:
        terminal.advance(10, 40)  # resumed here, so that no pace is known yet
        assert "left" not in drawn(terminal, console)
        now[0] += 20.0
        terminal.stage("another asset")
        terminal.advance(12, 40)
        assert "0:04:40 left" in drawn(terminal, console)
        terminal.advance(1, 3)
        assert "left" not in drawn(terminal, console), "another count"


def test_warnings_stay_above_the_line(console, capsys):
    with TerminalProgress(console=console) as terminal:
        terminal.stage("meshing [1/2]")
        terminal.warn("thin [walls]")
        assert "meshing [1/2]" in drawn(terminal, console)
    assert "warning: thin [walls]" in shown(console) and capsys.readouterr().err == ""


@pytest.mark.parametrize("quiet", [True, False])
def test_without_a_terminal_there_are_only_warnings(quiet, capsys):
    with TerminalProgress(quiet=quiet) as terminal:
        terminal.stage("meshing")
        terminal.advance(1, 2)
        terminal.warn("thin walls")
        print("a result")
    captured = capsys.readouterr()
    assert (captured.out, captured.err) == ("a result\n", "warning: thin walls\n")


def test_quiet_in_a_terminal(console, capsys):
    with TerminalProgress(quiet=True, console=console) as terminal:
        terminal.stage("meshing")
        terminal.warn("thin walls")
    assert console.file.getvalue() == "" and capsys.readouterr().err == "warning: thin walls\n"

"""The command line: its help, the commands that print or write little, and how it ends."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from toys import painted

import genmf_mi
from genmf_mi.assets import samples
from genmf_mi.cli import main as cli
from genmf_mi.core.config import RefineConfig
from genmf_mi.pipeline import evaluation
from genmf_mi.render import scene

HEAVY = {"mitsuba", "drjit", "torch", "pymeshlab", "matplotlib", "igl", "trimesh", "scipy", "numpy", "rich"}
COMMANDS = (
    "refine",
    "evaluate",
    "batch",
    "merge",
    "sweep",
    "convert",
    "scene",
    "samples",
    "stress",
    "weights",
    "doctor",
)


pytestmark = pytest.mark.usefixtures("workplace")


class TestHelp:
    @pytest.mark.parametrize(("arguments", "code"), [(["--help"], 0), ([], 2)])
    def test_all_commands_are_listed(self, arguments, code, capsys):
        assert cli.main(arguments) == code
        text = capsys.readouterr().out
        assert all(f"genmf-mi {command}" in text for command in COMMANDS)

    def test_unknown_command(self, capsys):
        assert cli.main(["refien", "a.glb"]) == 2
        captured = capsys.readouterr()
        assert "no command 'refien'" in captured.err.splitlines()[0] and "genmf-mi refine" in captured.err

    def test_version(self, capsys):
        assert cli.main(["--version"]) == 0
        assert capsys.readouterr().out.strip() == genmf_mi.__version__

    @pytest.mark.parametrize("command", COMMANDS)
    def test_of_each_command(self, command, capsys):
        with pytest.raises(SystemExit) as caught:
            cli.main([command, "--help"])
        assert caught.value.code == 0
        assert f"genmf-mi {command}" in capsys.readouterr().out

    def test_starts_nothing_heavy(self):
        """One process asks every command, and the overview does not even need tyro."""
        code = f"""
import contextlib, io, sys
from genmf_mi.cli import main as cli
for command in ("", *{COMMANDS}, "stress simulate", "stress train"):
    with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):
        cli.main([*command.split(), "--help"])
    print(command, *sorted({HEAVY} & set(sys.modules)), *([] if command else {{"tyro"}} & set(sys.modules)))
"""
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, encoding="utf-8", check=True)
        assert [line.strip() for line in done.stdout.splitlines()] == ["", *COMMANDS, "stress simulate", "stress train"]

    def test_every_setting_is_explained(self, capsys):
        with pytest.raises(SystemExit):
            cli.main(["refine", "--help"])
        text = re.sub(r"[\s│|]+", " ", capsys.readouterr().out)
        for name in RefineConfig.__dataclass_fields__:
            if name != "weights":
                assert f"--{name.replace('_', '-')}" in text
        assert "Longest side of the printed part" in text and "L_geo" in text


ROW = {"ssim": 0.91234, "lpips_alex": 0.1, "lpips_vgg": None, "g_ssim": 0.8, "g_lpips": 0.2}
SCORES = {"asset": "toy", "before": ROW, "after": ROW, "unseen": {"before": ROW, "after": ROW}}


class TestEvaluateOutput:
    @pytest.fixture
    def calls(self, monkeypatch):
        calls = []
        monkeypatch.setattr(evaluation, "evaluate", lambda *a, **k: calls.append((a, k)) or SCORES)
        return calls

    def test_table(self, calls, capsys):
        assert cli.main(["evaluate", "a.glb", "b.stl", "--size-mm", "80"]) == 0
        text = capsys.readouterr().out
        assert text.count("0.9123") == 4 and text.count("–") >= 4 and "unseen: after" in text
        ((paths, options),) = calls
        assert [str(path) for path in paths] == ["a.glb", "b.stl"] and options["size_mm"] == 80

    @pytest.mark.usefixtures("calls")
    def test_json(self, capsys):
        assert cli.main(["evaluate", "a.glb", "b.stl", "--json"]) == 0
        assert json.loads(capsys.readouterr().out) == SCORES


def test_scene_command_prints_a_scene(capsys):
    assert cli.main(["scene", painted("toy.ply")]) == 0
    Path("my.xml").write_text(capsys.readouterr().out, encoding="utf-8")
    assert scene.read_defaults(Path("my.xml"))["mesh"] == "toy.ply"
    assert cli.main(["scene", "toy.ply", "--mesh", "a & b.ply"]) == 0
    Path("my.xml").write_text(capsys.readouterr().out, encoding="utf-8")
    assert scene.read_defaults(Path("my.xml"))["mesh"] == "a & b.ply"


def test_samples_command_names_what_it_writes(monkeypatch, capsys):
    monkeypatch.setattr(samples, "write", lambda name, folder: Path(folder) / f"{name}.glb")
    assert cli.main(["samples", "--out", "here"]) == 0
    captured = capsys.readouterr()
    assert captured.out.splitlines() == [f"here/{name}.glb" for name in samples.NAMES] and captured.err == ""


def test_weights_command(monkeypatch, capsys):
    from genmf_mi.losses import lpips_conversion

    calls = []
    monkeypatch.setattr(
        lpips_conversion, "install", lambda source, *, force: calls.append((source, force)) or Path("cache")
    )
    assert cli.main(["weights"]) == cli.main(["weights", "--from", "here", "--force"]) == 0
    assert calls == [(None, False), (Path("here"), True)]
    assert capsys.readouterr().out == 2 * "LPIPS weights in cache\n"


def installed(*arguments: str, **environment: str) -> subprocess.CompletedProcess:
    command = [sys.executable, "-m", "genmf_mi", *arguments]
    return subprocess.run(command, capture_output=True, encoding="utf-8", env=os.environ | environment)


def test_terminal_without_unicode():
    """The help holds mathematical signs."""
    done = installed("refine", "--help", PYTHONIOENCODING="ascii")
    assert done.returncode == 0 and "1 ? SSIM" in done.stdout


def test_python_m():
    """The same command, also in the way that it fails."""
    done = installed("refine", "nowhere.glb")
    assert done.returncode == 2
    assert done.stderr.startswith("error: ") and len(done.stderr.splitlines()) == 1

"""The command line: its help, what reaches the settings, and what a person reads at the end."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
from toys import painted

import genmf_mi
from genmf_mi.cli import batch, progress
from genmf_mi.cli import main as cli
from genmf_mi.core.config import PRESETS, RefineConfig
from genmf_mi.pipeline import displacement
from genmf_mi.pipeline import evaluation as evaluate
from genmf_mi.render import scene, target

HEAVY = {"mitsuba", "drjit", "torch", "pymeshlab", "matplotlib", "igl"}
COMMANDS = ("refine", "evaluate", "batch", "sweep", "convert", "scene", "samples", "stress", "weights", "doctor")


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
        """One process asks every command."""
        code = f"""
import contextlib, io, sys
from genmf_mi import cli
for command in {COMMANDS}:
    with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):
        cli.main([command, "--help"])
    print(command, *sorted({HEAVY} & set(sys.modules)))
"""
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, encoding="utf-8", check=True)
        assert done.stdout.split("\n")[:-1] == list(COMMANDS)

    def test_every_setting_is_explained(self, capsys):
        with pytest.raises(SystemExit):
            cli.main(["refine", "--help"])
        text = re.sub(r"[\s│|]+", " ", capsys.readouterr().out)
        for name in RefineConfig.__dataclass_fields__:
            if name != "weights":
                assert f"--{name.replace('_', '-')}" in text
        assert "Longest side of the printed part" in text and "L_geo" in text


class TestSettings:
    @pytest.fixture
    def chosen(self, monkeypatch):
        """What the command would run with."""
        calls = []
        monkeypatch.setattr(
            progress, "run_refine", lambda asset, config, **options: calls.append((asset, config, options))
        )

        def of(*arguments: str) -> tuple[str, RefineConfig, dict]:
            assert cli.main(["refine", *arguments]) == 0
            return calls[-1]

        return of

    def test_defaults(self, chosen):
        asset, config, options = chosen("bus.glb")
        assert (asset, config) == ("bus.glb", RefineConfig())
        assert options == {"out": None, "quiet": False, "textured": None, "scene": None, "references": (),
                           "verify": False, "force": False, "resume": False, "save_exr": False}  # fmt: skip

    @pytest.mark.parametrize("preset", PRESETS)
    @pytest.mark.parametrize("form", ["--preset {}", "--preset={}"])
    def test_preset(self, chosen, preset, form):
        assert chosen("bus.glb", *form.format(preset).split())[1] == PRESETS[preset]
        assert chosen(*form.format(preset).split(), "bus.glb")[1] == PRESETS[preset]

    @pytest.mark.parametrize("before", [True, False])
    def test_overrides_on_top_of_a_preset(self, chosen, before):
        overrides = ["--size-mm", "80", "--iterations", "7", "--view-jitter", "10", "5", "--method", "displacement",
                     "--silhouettes", "--device", "cpu"]  # fmt: skip
        preset = ["--preset", "draft"]
        _, config, _ = chosen("bus.glb", *(overrides + preset if before else preset + overrides))
        assert config == replace(PRESETS["draft"], size_mm=80.0, iterations=7, view_jitter=(10.0, 5.0),
                                 method="displacement", silhouettes=True, device="cpu")  # fmt: skip

    @pytest.mark.parametrize("preset", PRESETS)
    @pytest.mark.parametrize("name", ["score_vgg", "silhouettes", "stress"])
    def test_switches_of_any_preset_both_ways(self, chosen, preset, name):
        flag = name.replace("_", "-")
        for word, value in ((f"--{flag}", True), (f"--no-{flag}", False)):
            _, config, _ = chosen("bus.glb", "--preset", preset, word)
            assert config == replace(PRESETS[preset], **{name: value})

    def test_weights(self, chosen):
        _, config, _ = chosen("bus.glb", "--preset", "paper", "--grey-l1", "0.25", "--gradient-sign", "0")
        assert config.weights == replace(PRESETS["paper"].weights, grey_l1=0.25, gradient_sign=0.0)

    def test_everything_else(self, chosen):
        _, _, options = chosen("bus.npz", "--textured", "bus.glb", "--out", "here", "--scene", "my.xml", "--reference",
                               "a.png@0,10",
                               "--reference", "b.png@-90,5", "--verify", "--force", "--save-exr",
                               "--quiet")  # fmt: skip
        assert options == {"out": Path("here"), "quiet": True, "scene": Path("my.xml"), "force": True, "resume": False,
                           "textured": Path("bus.glb"),
                           "references": ("a.png@0,10", "b.png@-90,5"), "verify": True, "save_exr": True}  # fmt: skip
        assert chosen("bus.glb", "--resume")[2]["resume"]

    @pytest.mark.parametrize(
        "arguments",
        [["bus.glb", "--size-mm", "large"], ["bus.glb", "--no-such-thing"], ["bus.glb", "--preset", "fast"], [],
         ["bus.glb", "--method", "magic"], ["bus.glb", "--view-jitter", "3"]],
    )  # fmt: skip
    def test_what_cannot_be_understood(self, arguments, capsys):
        with pytest.raises(SystemExit) as caught:
            cli.main(["refine", *arguments])
        assert caught.value.code == 2
        captured = capsys.readouterr()
        assert captured.err and "Traceback" not in captured.err + captured.out


SMALL = ["--iterations", "3", "--resolution", "96", "--max-faces", "3000", "--edge-mm", "4", "--device", "cpu",
         "--no-score-vgg", "--no-stress"]  # fmt: skip


@pytest.mark.usefixtures("lpips_weights")
class TestWholeRun:
    @pytest.fixture(autouse=True)
    def _small(self, monkeypatch):
        monkeypatch.setattr(evaluate, "RESOLUTION", 64)
        monkeypatch.setattr(evaluate, "SAMPLES", 4)
        monkeypatch.setattr(target, "FINEST", 12_000)
        monkeypatch.setattr(displacement, "AMPLITUDES", (0.5,))

    def test_ctrl_c(self, capsys, monkeypatch, two_views):
        """Said, with what to do next; not a failure, since the part so far is there."""

        def stop(self, index, count, terms):
            raise KeyboardInterrupt

        monkeypatch.setattr(progress.Terminal, "iteration", stop)
        assert cli.main(["refine", painted("toy.ply"), *SMALL, "--scene", str(two_views), "--out", "here"]) == 0
        captured = capsys.readouterr()
        assert "interrupted after 1 iterations" in captured.out and "--resume" in captured.out
        assert Path("here/refined.3mf").exists() and Path("here/checkpoint.npz").exists()


def test_stress_is_printed_where_it_was_verified(monkeypatch, capsys):
    """A table more, with the ratios; the scores of the shape without the stress stage among the others."""
    stress = {"von_mises_mpa": {"p99_9": 2.0, "mean": 0.4}, "surface_band": {"mean": 0.5, "p99_9": 1.5}}
    ratios = dict.fromkeys(("p99_9", "mean", "surface_band_mean", "surface_band_p99_9"), 1.25)
    metrics = {
        **SCORES,
        "unconstrained": ROW,
        "stress": {"shapes": {"before": stress, "after": stress}, "ratio": {"after": ratios}},
        "relief_mm": {"max": 0.9, "mean": 0.2},
        "solid": {"watertight": True, "bodies": 1, "self_intersections": 0},
        "seconds": {"total": 1.0},
        "interrupted": False,
    }
    asked = []
    result = SimpleNamespace(metrics=metrics)
    monkeypatch.setattr(progress, "refine", lambda *_, **options: asked.append(options["verify"]) or result)
    assert cli.main(["refine", "toy.ply", "--quiet", "--verify"]) == 0
    text = capsys.readouterr().out
    assert asked == [True]
    assert "finite elements" in text and text.count("×1.25") == 4 and "unconstrained" in text


ROW = {"ssim": 0.91234, "lpips_alex": 0.1, "lpips_vgg": None, "g_ssim": 0.8, "g_lpips": 0.2}
SCORES = {"asset": "toy", "before": ROW, "after": ROW, "unseen": {"before": ROW, "after": ROW}}


class TestEvaluateOutput:
    @pytest.fixture
    def calls(self, monkeypatch):
        calls = []
        monkeypatch.setattr(evaluate, "evaluate", lambda *a, **k: calls.append((a, k)) or SCORES)
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
    Path("my.xml").write_text(capsys.readouterr().out)
    assert scene.read_defaults(Path("my.xml"))["mesh"] == "toy.ply"


class TestBatch:
    @pytest.fixture
    def commands(self, monkeypatch):
        """Instead of processes: `bad` fails, the others leave metrics."""
        seen = []

        def run(command, **_):
            seen.append(command[3:])
            folder = Path(command[command.index("--out") + 1])
            if folder.name == "bad":
                return SimpleNamespace(returncode=2, stderr="a warning\nerror: bad.glb is empty.\n")
            folder.mkdir(parents=True, exist_ok=True)
            (folder / "metrics.json").write_text("{}")
            return SimpleNamespace(returncode=0, stderr="")

        monkeypatch.setattr(batch.subprocess, "run", run)
        return seen

    def test_one_that_fails_does_not_stop_the_rest(self, commands, capsys):
        assert cli.main(["batch", "bad.glb", "good.glb", "--arguments=--size-mm 80"]) == 1
        assert [words[:4] for words in commands] == [["refine", f"{name}.glb", "--out", f"runs/{name}"]
                                                     for name in ("bad", "good")]  # fmt: skip
        assert all(words[4:] == ["--quiet", "--force", "--size-mm", "80"] for words in commands)
        outcomes = json.loads(Path("runs/batch.json").read_text())
        assert outcomes["bad"] == {"state": "failed", "error": "error: bad.glb is empty."}
        assert outcomes["good"]["state"] == "refined"
        assert "bad: failed error: bad.glb is empty." in capsys.readouterr().out

    def test_again_goes_on(self, commands):
        """What is finished is skipped, what was interrupted is resumed."""
        for name, content in (("done", "{}"), ("half", '{"interrupted": true}')):
            Path("runs", name).mkdir(parents=True)
            Path("runs", name, "metrics.json").write_text(content)
        Path("runs/half/checkpoint.npz").touch()
        assert cli.main(["batch", "done.glb", "half.glb"]) == 0
        ((*_, last),) = commands
        assert commands[0][1] == "half.glb" and last == "--resume"
        assert json.loads(Path("runs/batch.json").read_text())["done"]["state"] == "skipped"


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

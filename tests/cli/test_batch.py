"""``genmf-mi batch``: what is refined, skipped and resumed, and what is recorded of it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
import yaml

from genmf_mi.cli import batch
from genmf_mi.cli import main as cli
from genmf_mi.core.config import RefineConfig
from genmf_mi.pipeline.run_folder import CHECKPOINT, CONFIG, METRICS

pytestmark = pytest.mark.usefixtures("workplace")


@pytest.fixture
def commands(monkeypatch) -> list[list[str]]:
    """The refinements that would run in processes: `bad` fails, the others leave metrics."""
    calls = []

    def run(command, **_):
        calls.append(command[3:])
        folder = Path(command[command.index("--out") + 1])
        if folder.name == "bad":
            return SimpleNamespace(returncode=2, stderr="a remark\nerror: bad.glb is empty.\n")
        folder.mkdir(parents=True, exist_ok=True)
        (folder / METRICS).write_text("{}")
        return SimpleNamespace(returncode=0, stderr="warning: it is thin\n" if folder.name == "thin" else "")

    monkeypatch.setattr(batch.subprocess, "run", run)
    return calls


def existing(name: str, config: RefineConfig | None = None, metrics: str = "{}") -> Path:
    """A run in ``runs``, of the default settings if none are given."""
    folder = Path("runs", name)
    folder.mkdir(parents=True)
    (folder / CONFIG).write_text(yaml.safe_dump({"asset": name, **(config or RefineConfig()).to_dict()}))
    (folder / METRICS).write_text(metrics)
    return folder


def outcomes() -> dict[str, dict]:
    return json.loads(Path("runs/batch.json").read_text(encoding="utf-8"))


def refined(commands: list[list[str]]) -> list[str]:
    return [Path(words[1]).stem for words in commands]


def test_one_that_fails_does_not_stop_the_rest(commands, capsys):
    assert cli.main(["batch", "bad.glb", "good.glb", "--arguments=--size-mm 80"]) == 1
    assert [words[:4] for words in commands] == [["refine", f"{name}.glb", "--out", f"runs/{name}"]
                                                 for name in ("bad", "good")]  # fmt: skip
    assert all(words[4:] == ["--quiet", "--force", "--size-mm", "80"] for words in commands)
    assert outcomes()["bad"] == {"state": "failed", "error": "error: bad.glb is empty."}
    assert outcomes()["good"] == {"state": "refined", "metrics": "runs/good/metrics.json"}
    assert "bad: failed error: bad.glb is empty." in capsys.readouterr().out


def test_warnings_are_recorded_and_printed(commands, capsys):
    assert cli.main(["batch", "thin.glb"]) == 0
    assert outcomes()["thin"]["warnings"] == ["it is thin"]
    assert capsys.readouterr().err == "warning: thin: it is thin\n"


def test_again_continues(commands):
    """Finished runs are skipped, interrupted ones resumed."""
    existing("complete")
    (existing("half", metrics='{"interrupted": true}') / CHECKPOINT).touch()
    assert cli.main(["batch", "complete.glb", "half.glb"]) == 0
    ((*_, last),) = commands
    assert refined(commands) == ["half"] and last == "--resume"
    assert outcomes()["complete"]["state"] == "skipped"


def test_runs_of_other_settings_are_not_taken_for_these(commands, capsys):
    """The others of the batch are refined all the same."""
    existing("large", RefineConfig(size_mm=90.0))
    existing("small", RefineConfig(size_mm=80.0))
    existing("elsewhere", replace(RefineConfig(size_mm=80.0), device="cpu"))
    command = ["batch", "large.glb", "small.glb", "elsewhere.glb", "new.glb", "--arguments=--size-mm 80"]
    assert cli.main(command) == 1
    assert refined(commands) == ["new"]
    assert {name: outcome["state"] for name, outcome in outcomes().items()} == {
        "large": "failed", "small": "skipped", "elsewhere": "skipped", "new": "refined"}  # fmt: skip
    error = outcomes()["large"]["error"]
    assert error.startswith("error: ") and "size_mm" in error and "--force" in error
    assert error in capsys.readouterr().out


def test_force_replaces_them(commands):
    existing("large", RefineConfig(size_mm=90.0))
    (existing("half", metrics='{"interrupted": true}') / CHECKPOINT).touch()
    existing("complete")
    assert cli.main(["batch", "large.glb", "half.glb", "complete.glb", "--force"]) == 0
    assert refined(commands) == ["large", "half", "complete"]
    assert all("--force" in words and "--resume" not in words for words in commands)


def test_a_run_without_the_simulations_that_are_asked_for(commands):
    existing("plain")
    existing("verified", metrics='{"stress": {}}')
    assert cli.main(["batch", "plain.glb", "verified.glb", "--arguments=--verify"]) == 1
    assert "made without --verify" in outcomes()["plain"]["error"]
    assert outcomes()["verified"]["state"] == "skipped" and commands == []


@pytest.mark.parametrize(
    ("file", "content"),
    [(METRICS, b""), (METRICS, b"{"), (METRICS, b"[]"), (METRICS, b"\xff\xfe"), (CONFIG, b"{"), (CONFIG, b""),
     (CONFIG, b"\xff\xfe"), (CONFIG, None)],
)  # fmt: skip
def test_a_damaged_run_does_not_stop_the_rest(commands, file, content):
    path = existing("damaged") / file
    path.write_bytes(content) if content is not None else path.unlink()
    assert cli.main(["batch", "damaged.glb", "good.glb"]) == 1
    assert refined(commands) == ["good"]
    assert outcomes()["damaged"]["state"] == "failed"
    assert file in outcomes()["damaged"]["error"] and "--force" in outcomes()["damaged"]["error"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [("--out here", "--arguments cannot hold --out"), ("--resume", "--arguments cannot hold"),
     ("--scene 'my file", "--arguments cannot be split into words"), ("--size-mm -1", "size-mm")],
)  # fmt: skip
def test_arguments_that_cannot_be_passed_on(commands, arguments, message, capsys):
    assert cli.main(["batch", "a.glb", f"--arguments={arguments}"]) == 2
    assert message in capsys.readouterr().err and commands == []

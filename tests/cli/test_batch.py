"""``genmf-mi batch``: what is refined, skipped and resumed, and what is recorded and printed of it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
import yaml
from toys import painted

from genmf_mi.batch import execution, journal
from genmf_mi.batch.journal import BatchOutcome
from genmf_mi.cli import main as cli
from genmf_mi.core.config import RefineConfig
from genmf_mi.core.errors import AssetError
from genmf_mi.pipeline.run_folder import CHECKPOINT, CONFIG, METRICS, RunFolder

pytestmark = pytest.mark.usefixtures("workplace")


@pytest.fixture
def calls(monkeypatch) -> list[tuple[str, dict]]:
    """The refinements that would run: `bad` fails, the others leave metrics."""
    calls = []

    def refine(asset, config, *, out, progress, **options):
        calls.append((out.name, {"asset": asset, "config": config, **options}))
        if out.name == "bad":
            raise AssetError("bad.ply is empty.")
        if out.name == "thin":
            progress.warn("it is thin")
        out.mkdir(parents=True, exist_ok=True)
        (out / METRICS).write_text("{}")
        (out / CHECKPOINT).unlink(missing_ok=True)
        return SimpleNamespace(metrics={})

    monkeypatch.setattr(execution, "refine", refine)
    monkeypatch.setattr(RunFolder, "load", lambda folder: (None, []))
    return calls


def batch(*arguments: str) -> int:
    """In this process; eggs of these names are written, each of its own content."""
    for name in arguments:
        if name.endswith(".ply") and "*" not in name and not Path(name).exists():
            painted(name)
            Path(name).write_bytes(Path(name).read_bytes().replace(b"ply\n", f"ply\ncomment {name}\n".encode(), 1))
    return cli.main(["batch", "--engine", "inline", *arguments])


def existing(name: str, config: RefineConfig | None = None, metrics: str = "{}") -> Path:
    """A run in ``runs`` of `genmf-mi refine`, of the default settings if none are given."""
    folder = Path("runs", name)
    folder.mkdir(parents=True)
    (folder / CONFIG).write_text(yaml.safe_dump({"asset": name, **(config or RefineConfig()).to_dict()}))
    (folder / METRICS).write_text(metrics)
    return folder


def outcomes() -> dict[str, BatchOutcome]:
    return journal.latest(journal.read("runs"))


def refined(calls: list[tuple[str, dict]]) -> list[str]:
    return [name for name, _ in calls]


def test_one_that_fails_does_not_stop_the_rest(calls, capsys):
    assert batch("bad.ply", "good.ply", "--arguments=--size-mm 80 --scene my.xml --verify --print-check") == 1
    assert refined(calls) == []  # there is no scene of that name
    assert outcomes()["good"].cause == "asset" and "my.xml" in outcomes()["good"].error
    Path("my.xml").write_text("<scene/>")
    assert batch("bad.ply", "good.ply", "--arguments=--size-mm 80 --scene my.xml --verify --print-check") == 1
    assert refined(calls) == ["bad", "good"]
    for name, options in calls:
        assert options["asset"] == f"{name}.ply" and options["force"] and not options["resume"]
        assert options["config"].size_mm == 80 and options["scene"] == "my.xml" and options["verify"]
        assert options["print_check"] == "auto"
    assert (outcomes()["bad"].state, outcomes()["bad"].error) == ("failed", "bad.ply is empty.")
    assert outcomes()["good"].state == "refined" and outcomes()["good"].metrics() == {}
    printed = capsys.readouterr().out
    assert "bad: failed error: bad.ply is empty." in printed and "1 failed, 1 refined" in printed


def test_warnings_are_recorded_and_printed(calls, capsys):
    assert batch("thin.ply") == 0
    assert outcomes()["thin"].warnings == ("it is thin",)
    assert capsys.readouterr().err == "warning: thin: it is thin\n"


def test_again_continues(calls, capsys):
    """Finished runs are skipped, interrupted ones resumed."""
    existing("complete")
    (existing("half", metrics='{"interrupted": true}') / CHECKPOINT).touch()
    assert batch("complete.ply", "half.ply") == 0
    ((name, options),) = calls
    assert name == "half" and options["resume"] and not options["force"]
    assert outcomes()["complete"].state == "skipped" and "complete: skipped" in capsys.readouterr().out


def test_runs_of_other_settings_are_not_taken_for_these(calls, capsys):
    """The others of the batch are refined all the same."""
    existing("large", RefineConfig(size_mm=90.0))
    existing("small", RefineConfig(size_mm=80.0))
    existing("elsewhere", replace(RefineConfig(size_mm=80.0), device="cpu"))
    assert batch("large.ply", "small.ply", "elsewhere.ply", "new.ply", "--arguments=--size-mm 80") == 1
    assert refined(calls) == ["new"]
    assert {name: outcome.state for name, outcome in outcomes().items()} == {
        "large": "failed", "small": "skipped", "elsewhere": "skipped", "new": "refined"}  # fmt: skip
    error = outcomes()["large"].error
    assert "size_mm" in error and "--force" in error and error in capsys.readouterr().out


def test_force_replaces_them(calls):
    existing("large", RefineConfig(size_mm=90.0))
    (existing("half", metrics='{"interrupted": true}') / CHECKPOINT).touch()
    existing("complete")
    assert batch("large.ply", "half.ply", "complete.ply", "--force") == 0
    assert refined(calls) == ["large", "half", "complete"]
    assert all(options["force"] and not options["resume"] for _, options in calls)


def test_a_run_without_the_simulations_that_are_asked_for(calls):
    existing("plain")
    existing("verified", metrics='{"stress": {}}')
    assert batch("plain.ply", "verified.ply", "--arguments=--verify") == 1
    assert "made without --verify" in outcomes()["plain"].error
    assert outcomes()["verified"].state == "skipped" and calls == []


@pytest.mark.parametrize(
    ("file", "content", "ours"),
    [(METRICS, b"", True), (METRICS, b"{", True), (METRICS, b"[]", True), (METRICS, b"\xff\xfe", True),
     (CONFIG, b"{", False), (CONFIG, b"", False), (CONFIG, b"\xff\xfe", False), (CONFIG, None, False)],
)  # fmt: skip
def test_a_damaged_run_does_not_stop_the_rest(calls, capsys, file, content, ours):
    """It is done again where its settings say that it is ours; else the folder is left alone."""
    path = existing("damaged") / file
    path.write_bytes(content) if content is not None else path.unlink()
    assert batch("damaged.ply", "good.ply") == int(not ours)
    assert refined(calls) == (["damaged", "good"] if ours else ["good"])
    outcome = outcomes()["damaged"]
    assert outcome.state == ("refined" if ours else "failed")
    said = capsys.readouterr().err if ours else outcome.error
    assert file in said and ("done again" if ours else "--force") in said


@pytest.mark.parametrize(
    ("arguments", "message"),
    [("--out here", "--arguments cannot hold --out"), ("--resume", "--arguments cannot hold"),
     ("--scene 'my file", "--arguments cannot be split into words"), ("--size-mm -1", "size-mm")],
)  # fmt: skip
def test_arguments_that_cannot_be_passed_on(calls, arguments, message, capsys):
    assert batch("a.ply", f"--arguments={arguments}") == 2
    assert message in capsys.readouterr().err and calls == []


def test_manifests_patterns_and_folders(calls, capsys):
    Path("in/deep").mkdir(parents=True)
    for name in ("in/a.ply", "in/deep/b.ply", "c1.ply", "c2.ply", "d.ply"):
        painted(name)
        Path(name).write_bytes(Path(name).read_bytes().replace(b"ply\n", f"ply\ncomment {name}\n".encode(), 1))
    Path("in/notes.txt").touch()
    Path("list.csv").write_text("asset,name,size_mm\nd.ply,small,40\nd.ply,large,\n")
    assert batch("in", "c*.ply", "list.csv", "--arguments=--size-mm 120") == 0
    assert {name: options["config"].size_mm for name, options in calls} == {
        "a": 120, "deep_b": 120, "c1": 120, "c2": 120, "small": 40, "large": 120}  # fmt: skip
    assert "6 refined" in capsys.readouterr().out
    assert json.loads(Path("runs/outcomes.jsonl").read_text().splitlines()[0])["items"] == 6


def test_array_task_without_shard_is_warned_of(calls, capsys, monkeypatch):
    monkeypatch.setenv("AWS_BATCH_JOB_ARRAY_INDEX", "1")
    monkeypatch.setenv("AWS_BATCH_JOB_ARRAY_SIZE", "2")
    assert batch("a.ply", "b.ply") == 0
    assert "--shard auto" in capsys.readouterr().err and refined(calls) == ["a", "b"]
    assert batch("c.ply", "d.ply", "--shard", "auto") == 0
    assert refined(calls)[2:] == ["d"] and "warning" not in capsys.readouterr().err

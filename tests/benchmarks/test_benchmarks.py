"""The catalogue of the benchmarks against what lies in the folders, and the menu that is made from it."""

from __future__ import annotations

import inspect
import json
from pathlib import Path

import pytest

from benchmarks import __main__ as menu
from benchmarks import record, runs
from benchmarks.catalogue import BY_NAME, CATALOGUE, markdown
from benchmarks.inputs import EIGHT_ASSETS, Inputs

ROOT = Path(record.FOLDER).parents[1]
HELPERS = {"__init__", "__main__", "catalogue", "inputs", "record", "runs", "verification.__init__"}


@pytest.fixture(autouse=True)
def _no_assets(monkeypatch):
    monkeypatch.delenv("GENMF_TEST_ASSETS", raising=False)


def test_every_result_has_a_command():
    assert {path.name for path in record.FOLDER.glob("*.json")} == {one.result for one in CATALOGUE}


def test_every_module_is_listed():
    files = (ROOT / "benchmarks").rglob("*.py")
    modules = {".".join(file.relative_to(ROOT / "benchmarks").with_suffix("").parts) for file in files}
    assert modules - HELPERS == set(BY_NAME)


@pytest.mark.parametrize("name", BY_NAME)
def test_entry_function_can_be_called_with_the_inputs_alone(name):
    function = BY_NAME[name].main()
    first, *others = inspect.signature(function).parameters.values()
    assert first.name == "inputs" and function.__module__ == f"benchmarks.{name}"
    assert all(one.default is not one.empty and one.kind is one.KEYWORD_ONLY for one in others)
    assert function.__doc__


def test_results_page_lists_file_command_and_place():
    page = (record.FOLDER / "README.md").read_text(encoding="utf-8")
    assert markdown() in page


@pytest.mark.parametrize("one", CATALOGUE, ids=lambda one: one.name)
def test_quoted_documents_have_the_section(one):
    for place in one.quoted.split("; ") if one.quoted != "not quoted" else ():
        document, _, section = place.partition(", ")
        text = (ROOT / (document if document.endswith(".md") else f"{document}.md")).read_text(encoding="utf-8")
        assert not section or f"# {section}\n" in text


def test_published_verifications_have_a_command():
    entries = set(json.loads((record.FOLDER / "stress_verification.json").read_text(encoding="utf-8")))
    names = {name.partition(".")[2] for name in BY_NAME if name.startswith("verification.")}
    assert entries == names - {"assembly"} | {"assembly_seconds_cpu", "calculix_coarse", "machine"}


def test_menu(capsys):
    assert menu.main([]) == 0
    printed = capsys.readouterr().out
    for one in CATALOGUE:
        (line,) = (line for line in printed.splitlines() if line.startswith(f"{one.name} "))
        assert one.result in line and all(f"--{name}" in line for name in one.needs)
    assert "--all ASSETS_DIR" in printed


@pytest.mark.parametrize(
    ("arguments", "message"), [(["assets", "nothing"], "no benchmark nothing"), (["--all"], "--all needs the folder")]
)
def test_mistakes_are_refused(arguments, message, capsys):
    assert menu.main(arguments) == 2
    assert message in capsys.readouterr().err


@pytest.fixture
def calls(monkeypatch) -> list:
    """What was run instead of real benchmarks, in this order."""
    calls: list = []

    def memory(inputs: Inputs) -> None:
        calls.append(("memory", inputs))

    def limit(inputs: Inputs, *, steps: int = 16) -> None:
        calls.append(("stress_limit", inputs, steps))

    monkeypatch.setattr("benchmarks.memory.main", memory)
    monkeypatch.setattr("benchmarks.stress_limit.main", limit)
    return calls


def test_several_run_in_the_given_order(calls, tmp_path):
    options = ["--assets", str(tmp_path), "--names", "spot", "teacup"]
    assert menu.main(["stress_limit", "memory", *options]) == 0
    inputs = Inputs(assets=tmp_path, names=("spot", "teacup"))
    assert calls == [("stress_limit", inputs, 16), ("memory", inputs)]


def test_options_of_one(calls, tmp_path):
    assert menu.main(["stress_limit", "--steps", "2", "--assets", str(tmp_path)]) == 0
    assert calls == [("stress_limit", Inputs(assets=tmp_path), 2)]


def test_what_is_missing_is_named_before_anything_runs(calls):
    with pytest.raises(SystemExit, match="--assets is not given"):
        menu.main(["memory", "stress_limit"])
    assert calls == []


def test_all_runs_what_can_run(monkeypatch, capsys, tmp_path):
    started = []
    for one in CATALOGUE:
        monkeypatch.setattr(f"benchmarks.{one.name}.main", lambda inputs, name=one.name: started.append(name))
    assert menu.main(["--all", str(tmp_path)]) == 0
    assert started == [one.name for one in CATALOGUE if set(one.needs) <= {"assets"}]
    assert "verification.convergence: left out, it needs --meshes" in capsys.readouterr().out


def test_assets_and_meshes_by_name(tmp_path, monkeypatch):
    monkeypatch.setenv("GENMF_TEST_ASSETS", str(tmp_path))
    assert [path.stem for path in Inputs().asset_files(EIGHT_ASSETS)] == list(EIGHT_ASSETS)
    assert Inputs(names=("a",)).asset_files(EIGHT_ASSETS) == [tmp_path / "a.glb"]
    for name in ("bunny.ply", "cow.stl", "notes.txt"):
        (tmp_path / name).touch()
    meshes = Inputs(meshes=tmp_path)
    assert [path.name for path in meshes.mesh_files()] == ["bunny.ply", "cow.stl"]
    assert meshes.mesh_files(("cow",)) == [tmp_path / "cow.stl"]
    with pytest.raises(SystemExit, match="no mesh of the name arm"):
        meshes.mesh_files(("arm", "cow"))


def test_finished_runs_are_not_repeated_and_interrupted_ones_resumed(tmp_path, monkeypatch):
    commands = []
    monkeypatch.setattr(runs.subprocess, "run", lambda command, check: commands.append(command))
    assert runs.refined(Path("bus.glb"), tmp_path, "--no-stress") is None
    (tmp_path / runs.METRICS).write_text('{"asset": "bus"}')
    assert runs.refined(Path("bus.glb"), tmp_path, "--no-stress") == {"asset": "bus"}
    (tmp_path / runs.CHECKPOINT).touch()
    assert runs.refined(Path("bus.glb"), tmp_path, "--no-stress") is None
    assert [command[3:] for command in commands] == [
        ["refine", "bus.glb", "--out", str(tmp_path), "--quiet", mode, "--no-stress"]
        for mode in ("--force", "--resume")
    ]


def test_results_are_written_with_the_machine(tmp_path, monkeypatch):
    monkeypatch.setattr(record, "FOLDER", tmp_path)
    record.write("one", [1])
    written = json.loads((tmp_path / "one.json").read_text())
    assert written["results"] == [1] and {"cpu", "cores", "mitsuba"} <= set(written["machine"])
    record.write_verification("a", {"x": 1})
    record.write_verification("b", {"x": 2})
    assert json.loads((tmp_path / "stress_verification.json").read_text()) == {"a": {"x": 1}, "b": {"x": 2}}

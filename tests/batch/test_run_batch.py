"""Batches in this process: what is done, skipped, resumed, refused, and what the journal says of it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from toy_batches import CONFIG, starts

import genmf_mi
from genmf_mi import BatchItem
from genmf_mi.batch import journal
from genmf_mi.core.errors import ConfigError, OutputError
from genmf_mi.pipeline.run_folder import CHECKPOINT, METRICS

pytestmark = pytest.mark.usefixtures("workplace")


def lines(folder: str = "runs") -> list[dict]:
    return [line for line in journal.read(folder) if "name" in line]


def test_one_after_the_other_and_again(assets, batch):
    """The second time nothing is started, and nothing more is written of the items."""
    paths = assets("one", "thin", "bad")
    first = batch(paths)
    assert {name: one.state for name, one in first.items()} == {"one": "refined", "thin": "refined", "bad": "failed"}
    assert first["thin"].warnings == ("it is thin",) and first["one"].metrics()["iterations"] == 4
    assert first["bad"].cause == "asset" and first["bad"].error == "bad.glb is empty."
    assert first["one"].scores["lpips"] == 0.1 and first["one"].worker and first["one"].ended
    again = batch(paths)
    assert {name: one.state for name, one in again.items()} == {"one": "skipped", "thin": "skipped", "bad": "failed"}
    assert starts() == [("one", 0), ("thin", 0), ("bad", 0)] and len(lines()) == 3
    assert batch(paths, retry_failed=True)["bad"].state == "failed"
    assert starts()[3:] == [("bad", 0)]


def test_content_and_settings_decide_what_is_done(assets, batch):
    (path,) = assets("one")
    assert batch([path])["one"].state == "refined"
    Path(path).touch()  # another time, the same content
    assert batch([path])["one"].state == "skipped"
    outcome = batch([path], replace(CONFIG, size_mm=80.0))["one"]
    assert outcome.state == "failed" and outcome.cause == "config" and "size_mm" in outcome.error
    outcome = batch([path], verify=True)["one"]
    assert outcome.state == "failed" and "--verify" in outcome.error
    Path(path).write_bytes(Path(path).read_bytes().replace(b"comment one", b"comment two"))
    outcome = batch([path])["one"]
    assert outcome.state == "failed" and "another content" in outcome.error and "--force" in outcome.error
    assert batch([path], force=True)["one"].state == "refined"
    assert len(starts()) == 2


def test_same_content_is_done_once(assets, batch):
    (path,) = assets("one")
    Path("copy.ply").write_bytes(Path(path).read_bytes())
    outcomes = batch([path, "copy.ply", BatchItem("copy.ply", "small", {"size_mm": "60"})])
    assert [one.state for one in outcomes.values()] == ["refined", "duplicate", "refined"]
    assert outcomes["copy"].of == "one" and outcomes["copy"].good
    assert batch([path, "copy.ply"])["copy"].state == "duplicate"
    assert starts() == [("one", 0), ("small", 0)]


def test_texture_beside_an_asset_counts_as_its_content(workplace, batch):
    from PIL import Image

    Path("a.obj").write_text(
        "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvt 0 0\nusemtl m\n"
        "f 1/1 3/1 2/1\nf 1/1 2/1 4/1\nf 1/1 4/1 3/1\nf 2/1 3/1 4/1\n"
    )
    Path("a.mtl").write_text("newmtl m\nmap_Kd a.png\n")
    Image.new("RGB", (2, 2), "red").save("a.png")
    assert batch(["a.obj"])["a"].state == "refined"
    assert batch(["a.obj"])["a"].state == "skipped"
    Image.new("RGB", (2, 3), "blue").save("a.png")
    assert "another content" in batch(["a.obj"])["a"].error


def test_assets_in_memory(batch):
    vertices = np.array([[0, 1, 0], [1, 0, 1], [1, 0, -1], [-1, 0, 0]], float)
    faces = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]])
    mesh = genmf_mi.Asset.from_arrays("pyramid", vertices, faces, colours=np.eye(4)[:, :3])
    same = genmf_mi.Asset.from_arrays("same", vertices, faces, colours=np.eye(4)[:, :3])
    grid = np.stack(np.meshgrid(*[np.linspace(-1, 1, 9)] * 3, indexing="ij"), -1)
    field = genmf_mi.SdfAsset("ball", (np.linalg.norm(grid, axis=-1) - 0.6).astype(np.float32))
    first = batch([mesh, same, field])
    assert [one.state for one in first.values()] == ["refined", "duplicate", "refined"]
    assert batch(iter([mesh, field]))["ball"].state == "skipped"
    other = genmf_mi.Asset.from_arrays("pyramid", 2 * vertices, faces, colours=np.eye(4)[:, :3])
    assert batch([other])["pyramid"].state == "failed"


def test_interrupted_run_goes_on(assets, batch):
    (path,) = assets("one")
    batch([path])
    Path("runs/outcomes.jsonl").unlink()  # as if it had been killed
    Path("runs/one", CHECKPOINT).write_text("3")
    assert batch([path])["one"].state == "refined"
    assert starts() == [("one", 0), ("one", 3)]


@pytest.mark.parametrize(
    ("file", "content"),
    [(METRICS, b"{"), (METRICS, b"\xff\xfe"), (CHECKPOINT, b"torn"), ("config.yaml", b"{"), ("item.json", b"{")],
)
def test_damaged_run_is_said_and_done_again(assets, batch, file, content):
    paths = assets("one", "two")
    batch(paths)
    Path("runs/outcomes.jsonl").unlink()  # by which a run counts as complete as long as it has metrics
    Path("runs/one", file).write_bytes(content)
    outcomes = batch(paths)
    assert outcomes["two"].state == "skipped"
    if file == "item.json":  # the run itself is whole
        assert outcomes["one"].state == "skipped" and not outcomes["one"].warnings
        return
    assert outcomes["one"].state == "refined" and "done again" in outcomes["one"].warnings[0]
    assert json.loads(Path("runs/one", METRICS).read_text())["iterations"] == 4


def test_folder_of_somebody_else_is_left_alone(assets, batch):
    Path("runs/one").mkdir(parents=True)
    Path("runs/one/report.html").write_text("mine")
    outcomes = batch(assets("one", "two"))
    assert outcomes["one"].state == "failed" and "report.html" in outcomes["one"].error
    assert Path("runs/one/report.html").read_text() == "mine" and outcomes["two"].state == "refined"


def test_files_that_are_missing_are_outcomes(assets, batch):
    outcomes = batch([*assets("one"), "nowhere.glb", BatchItem("one.ply", "scene", {"scene": "no.xml"})])
    assert outcomes["nowhere"].cause == "asset" and "nowhere.glb" in outcomes["nowhere"].error
    assert outcomes["scene"].state == "failed" and "no.xml" in outcomes["scene"].error
    assert outcomes["one"].state == "refined"
    Path("nowhere.glb").write_bytes(Path("one.ply").read_bytes())
    assert batch(["nowhere.glb"])["nowhere"].cause == "asset"  # another reason now: it is no GLB


def test_defects_are_recorded_with_their_traceback(assets, batch):
    outcome = batch(assets("defect"))["defect"]
    assert outcome.cause == "defect" and "ZeroDivisionError" in outcome.error and "toy_refine.py" in outcome.error


def test_names_that_clash_in_a_stream_of_items(assets, batch):
    outcomes = list(genmf_mi.run_batch(iter([*assets("one"), "other/one.ply"]), CONFIG, executor="inline"))
    assert [one.state for one in outcomes] == ["refined", "failed"] and "name of its own" in outcomes[1].error


@pytest.mark.parametrize(
    ("items", "options", "message"),
    [(["a/x.glb", "b/x.glb"], {}, "Rename one"), ([BatchItem("x.glb", "../x")], {}, "name of a folder"),
     ([BatchItem("x.glb", settings={"size": 3})], {}, "no setting 'size'"),
     ([BatchItem("x.glb", settings={"size_mm": -3})], {}, "x.glb: size-mm"), (["x.glb"], {"fast": True}, "no option"),
     (["x.glb"], {"executor": "dask"}, "no executor"), (["x.glb"], {"shard": "0/3"}, "no shard 0/3"),
     (["x.glb"], {"shard": "third"}, "--shard takes"), (["x.glb"], {"shard": "auto"}, "job array")],
)  # fmt: skip
def test_refused_before_the_work(workplace, batch, items, options, message):
    with pytest.raises(ConfigError, match=message):
        batch(items, **options)
    assert not Path("runs").exists()


def test_one_batch_at_a_time_writes_a_journal(assets, batch):
    paths = assets("one", "two")
    running = genmf_mi.run_batch(paths, CONFIG, executor="inline")
    next(running)
    with pytest.raises(OutputError, match="another batch is writing"):
        batch(paths)
    assert [one.name for one in running] == ["two"]


def test_torn_line_is_passed_over(assets, batch):
    """The item that it was about is looked at again, and found to be done."""
    paths = assets("one", "two")
    batch(paths)
    file = Path("runs/outcomes.jsonl")
    file.write_bytes(file.read_bytes()[:-40])
    outcomes = batch(paths)
    assert [one.state for one in outcomes.values()] == ["skipped", "skipped"] and len(starts()) == 2
    assert journal.latest(journal.read("runs")).keys() == {"one", "two"}
    for line in file.read_text().splitlines():
        assert line.endswith("}") or "two" in line


def test_shards_do_all_of_it_and_know_of_each_other(assets, batch):
    paths = assets(*"abcdefg")
    parts = [batch(paths, shard=f"{i}/3") for i in (1, 2, 3)]
    assert [len(part) for part in parts] == [3, 2, 2]
    assert sorted(name for part in parts for name in part) == list("abcdefg")
    assert {path.name for path in Path("runs").glob("*.jsonl")} == {f"outcomes-{i}-of-3.jsonl" for i in (1, 2, 3)}
    assert {one.state for one in batch(paths).values()} == {"skipped"}  # in one part now
    assert len(starts()) == 7

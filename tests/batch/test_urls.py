"""Assets and output folders behind URLs, in fsspec's store in memory, which other processes cannot see."""

from __future__ import annotations

import json
from pathlib import Path

import fsspec
import pytest
from toy_batches import CONFIG, starts

import genmf_mi
from genmf_mi.batch import engine, execution, journal, storage
from genmf_mi.batch.arguments import items_of
from genmf_mi.batch.merge import merge
from genmf_mi.core.errors import AssetError, SetupError
from genmf_mi.pipeline.run_folder import CHECKPOINT, METRICS


@pytest.fixture(autouse=True)
def store(monkeypatch, workplace):
    """An empty store, and a cache of the test's own."""
    system = fsspec.filesystem("memory")
    system.store.clear()
    monkeypatch.setenv("GENMF_CACHE", str(workplace / "cache"))
    yield system
    system.store.clear()


def put(store, path: str, name: str) -> str:
    store.pipe_file(f"/{name}", Path(path).read_bytes())
    return f"memory://{name}"


def test_in_and_out(store, assets, batch):
    one, two = (put(store, path, f"in/{path}") for path in assets("one", "two"))
    outcomes = batch([one, two], out="memory://out")
    assert {name: outcome.state for name, outcome in outcomes.items()} == {"one": "refined", "two": "refined"}
    assert outcomes["one"].folder == "memory://out/one" and outcomes["one"].metrics()["iterations"] == 4
    assert json.loads(store.cat_file("/out/one/item.json"))["key"] == outcomes["one"].key
    assert {one.name for one in journal.latest(journal.read("memory://out")).values()} == {"one", "two"}
    assert [item.asset for item in items_of(["memory://in/t*.ply"])] == [two]
    again = batch(items_of(["memory://in/"]), out="memory://out")
    assert {outcome.state for outcome in again.values()} == {"skipped"}
    assert merge("memory://out").states == {"refined": 2}
    assert b"one" in store.cat_file("/out/gallery.html") and b"two" in store.cat_file("/out/outcomes.csv")


def test_journal_that_was_not_uploaded(store, assets, batch):
    """On another machine, which has neither cache nor journal, the run folders say what is done."""
    one = put(store, *assets("one"), "in/one.ply")
    batch([one], out="memory://out")
    store.rm_file("/out/outcomes.jsonl")
    for file in Path("cache").rglob("*.jsonl"):
        file.unlink()
    assert batch([one], out="memory://out")["one"].state == "skipped"


def test_checkpoints_are_uploaded_and_resumed_from(store, assets, batch, monkeypatch):
    monkeypatch.setattr(execution, "UPLOAD_EVERY", 0.0)
    monkeypatch.setattr(engine, "UPLOAD_EVERY", 0.0)
    one = put(store, *assets("one"), "in/one.ply")
    stop = execution.storage.upload

    def dies(path, url):
        stop(path, url)
        if url.endswith(CHECKPOINT) and path.read_text() == "3":
            raise SystemExit  # as if the machine had gone

    monkeypatch.setattr(storage, "upload", dies)
    with pytest.raises(SystemExit):
        batch([one], out="memory://out")
    assert store.cat_file(f"/out/one/{CHECKPOINT}") == b"3"
    monkeypatch.setattr(storage, "upload", stop)
    seen = []
    monkeypatch.setattr(execution, "_refined", lambda *a, real=execution._refined, **k: seen.append(k) or real(*a, **k))
    outcome = batch([one], out="memory://out")["one"]
    assert outcome.state == "refined" and seen == [{"resume": True}]
    assert not store.exists(f"/out/one/{CHECKPOINT}") and store.exists(f"/out/one/{METRICS}")


def test_what_an_asset_names_is_fetched_with_it(store, workplace, batch):
    from PIL import Image

    folder = Path("a")
    folder.mkdir()
    (folder / "a.obj").write_text(
        "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvt 0 0\nvt 1 1\nusemtl m\n"
        "f 1/1 3/1 2/2\nf 1/1 2/1 4/1\nf 1/2 4/1 3/1\nf 2/1 3/1 4/1\n"
    )
    (folder / "a.mtl").write_text("newmtl m\nmap_Kd tex/a.png\n")
    for file in folder.iterdir():
        put(store, str(file), f"in/{file.name}")
    missing = batch(["memory://in/a.obj"], out="memory://out")["a"]
    assert missing.cause == "asset" and "tex/a.png" in missing.error
    Image.new("RGB", (2, 2), "red").save("a.png")
    put(store, "a.png", "in/tex/a.png")
    assert batch(["memory://in/a.obj"], out="memory://out", retry_failed=True)["a"].state == "refined"


def test_manifest_behind_a_url(store, assets, batch):
    put(store, *assets("one"), "in/one.ply")
    store.pipe_file("/in/list.csv", b"asset,size_mm\none.ply,70\nball,\n")
    first, second = items_of(["memory://in/list.csv"])
    assert first.asset == "memory://in/one.ply" and second.asset == "ball"
    assert batch([first], out="runs")["one"].state == "refined" and starts() == [("one", 0)]


def test_file_urls_are_paths(assets, batch, workplace):
    (path,) = assets("one")
    outcomes = batch([f"file://{workplace}/{path}"], out=f"file://{workplace}/there")
    assert outcomes["one"].state == "refined" and Path("there/one", METRICS).exists()


def test_urls_that_do_not_answer(store, batch, assets, monkeypatch):
    outcomes = batch(["memory://in/none.glb", "nope://in/a.glb", *assets("one")])
    assert outcomes["none"].cause == "asset" and "nothing at memory://in/none.glb" in outcomes["none"].error
    assert outcomes["a"].state == "failed" and "nope://in/a.glb cannot be reached" in outcomes["a"].error
    assert outcomes["one"].state == "refined"

    def broken(*_):
        raise ImportError("Install s3fs to access S3")

    monkeypatch.setattr("fsspec.core.url_to_fs", broken)
    with pytest.raises(SetupError, match=r"pip install 'genmf-mi\[s3\]'"):
        storage.file_system("s3://bucket/a.glb")


def test_iterator_of_assets_goes_to_a_url(store, batch):
    assert list(genmf_mi.run_batch(iter(()), CONFIG, out="memory://out", executor="inline")) == []
    with pytest.raises(AssetError):
        execution._fetched.__globals__["load_asset"]("memory://nothing.glb")

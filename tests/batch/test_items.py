"""Items from manifests and their settings, shards, and the mistakes that people make with them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from genmf_mi.batch.arguments import items_of
from genmf_mi.batch.engine import work_of
from genmf_mi.batch.items import BatchItem, require_names, strided
from genmf_mi.batch.keys import key, token
from genmf_mi.batch.manifest import read_manifest
from genmf_mi.batch.shards import Shard, in_array, shard_of
from genmf_mi.batch.work import Work, with_settings
from genmf_mi.core.config import PRESETS
from genmf_mi.core.errors import ConfigError
from genmf_mi.core.regions import Regions, Stroke

pytestmark = pytest.mark.usefixtures("workplace")


def test_csv_and_jsonl_say_the_same():
    Path("sub").mkdir()
    Path("sub/list.csv").write_text(
        "\ufeffasset, name ,size-mm,printer,up,stress,view_jitter,grey_lpips,reference,verify\n"
        'bus.glb,,60,fdm-0.2,-z,no,"10,5",2,front.png@0;/side.png@90,true\n'
        "\n"
        "ball,my ball,,,,,,,,\n",
        encoding="utf-8",
    )
    rows = [
        {"asset": "bus.glb", "size_mm": 60, "printer": "fdm-0.2", "up": "-z", "stress": False, "view_jitter": [10, 5],
         "weights.grey_lpips": 2, "reference": ["front.png@0", "/side.png@90"], "verify": True},
        {"asset": "ball", "name": "my ball", "size_mm": None},
    ]  # fmt: skip
    Path("sub/list.jsonl").write_text("\n".join(map(json.dumps, rows)))
    for name in ("sub/list.csv", "sub/list.jsonl"):
        bus, ball = read_manifest(name)
        assert (bus.asset, bus.folder_name, ball.asset, ball.name) == ("sub/bus.glb", "bus", "ball", "my ball")
        assert "line 2" in bus.where or "line 1" in bus.where
        work = with_settings(Work(), bus.settings)
        assert (work.config.size_mm, work.config.printer, work.config.stress) == (60.0, "fdm-0.2", False)
        assert work.config.view_jitter == (10.0, 5.0) and work.config.weights.grey_lpips == 2.0
        assert work.up == "-z" and work.verify and work.references == ("sub/front.png@0", "/side.png@90")
        assert not ball.settings


def test_strokes_beside_an_asset_are_its_own_and_count_as_its_content():
    """Unless others are named; other strokes, or another mask, are other work."""
    Path("bus.glb").write_bytes(b"bus")
    item, strokes = BatchItem("bus.glb"), Path("bus.regions.json")
    assert work_of(item, Work()).config.regions is None
    strokes.write_text("{}")
    painted = work_of(item, Work())
    assert painted.config.regions == "bus.regions.json"
    before = key("bus.glb", painted), token("bus.glb", painted)
    strokes.write_text('{"other": 1}')
    assert key("bus.glb", painted) != before[0] and token("bus.glb", painted) != before[1]
    named = work_of(BatchItem("bus.glb", settings={"regions": "mine.json", "mask": "vertex-colours"}), Work())
    assert named.painted == {"regions": "mine.json"}
    dabs = [Stroke("flat", np.zeros((1, 3)), np.ones((1, 3)), radius) for radius in (1.0, 2.0)]
    keys = {key("bus.glb", Work(replace(PRESETS["draft"], regions=Regions((dab,))))) for dab in dabs}
    assert len(keys) == 2


def test_preset_of_an_item_comes_first():
    work = with_settings(Work(PRESETS["paper"]), {"size_mm": 50, "preset": "draft"})
    assert work.config.iterations == PRESETS["draft"].iterations and work.config.size_mm == 50
    assert with_settings(Work(PRESETS["paper"]), {}).config == PRESETS["paper"]


@pytest.mark.parametrize(
    ("text", "message"),
    [("file,size_mm\nbus.glb,3\n", "lacks the column asset: its first line has file, size_mm"),
     ("", "lacks the column asset: its first line has nothing"), ("asset\n\n", "holds no item"),
     ("asset,sise_mm\nbus.glb,3\n", "'sise_mm'. Did you mean size_mm"), ("asset,colour\na.glb,red\n", "--help"),
     ("asset,size_mm\na.glb,3\na.glb,3\n", "line 3 repeats list.csv, line 2"),
     ("asset\na.glb,3\n", "line 2 has 2 cells for 1 columns"), ("asset,size_mm\n,3\n", "line 2 lacks the asset")],
)  # fmt: skip
def test_csv_that_is_wrong(text, message):
    Path("list.csv").write_text(text)
    with pytest.raises(ConfigError, match=message):
        read_manifest("list.csv")


@pytest.mark.parametrize(
    ("text", "message"),
    [('{"asset": "a.glb"}\n{"asset": ', "line 2 is no JSON"), ("[1]", "line 1 is no object"),
     ('{"asset": 3}', "line 1 lacks the asset"), ('{"asset": "a", "size": 1}', "no setting 'size'")],
)  # fmt: skip
def test_jsonl_that_is_wrong(text, message):
    Path("list.jsonl").write_text(text)
    with pytest.raises(ConfigError, match=message):
        read_manifest("list.jsonl")


@pytest.mark.parametrize(
    ("settings", "message"),
    [({"size_mm": "large"}, "size-mm must be a number, not 'large'"), ({"stress": "maybe"}, "must be true or false"),
     ({"iterations": "1.5"}, "must be a whole number"), ({"printer": "laser"}, "must be one of smooth"),
     ({"size_mm": "-2"}, "size-mm is the longest side"), ({"view_jitter": "1"}, "must be a list"),
     ({"up": 3}, "must be one of auto"), ({"scene": True}, "must be text"), ({"size_mm": True}, "must be a number"),
     ({"size_mm": "nan"}, "finite")],
)  # fmt: skip
def test_settings_that_are_wrong(settings, message):
    with pytest.raises(ConfigError, match=message):
        with_settings(Work(), settings)


def test_names_that_clash():
    Path("list.csv").write_text("asset,size_mm\na/bus.glb,3\nb/Bus.glb,4\n")
    with pytest.raises(ConfigError, match=r"line 3 and list.csv, line 2 have the same name 'Bus'.*column name"):
        require_names(read_manifest("list.csv"))


@pytest.mark.parametrize(
    ("argument", "message"),
    [("nothing*.glb", "no file fits"), ("empty/", "holds no asset"), ("none.csv", "no manifest none.csv")],
)
def test_arguments_that_mean_nothing(argument, message):
    Path("empty").mkdir()
    with pytest.raises(ConfigError, match=message):
        items_of([argument])


def test_shards():
    assert list(strided(range(7), 1, 3)) == [1, 4]  # type: ignore[arg-type]
    assert shard_of("3/64", {}) == Shard(3, 64) and shard_of("", {}).file == "outcomes.jsonl"
    slurm = {"SLURM_ARRAY_TASK_ID": "14", "SLURM_ARRAY_TASK_MIN": "10", "SLURM_ARRAY_TASK_MAX": "18"}
    assert shard_of("auto", {**slurm, "SLURM_ARRAY_TASK_STEP": "2"}) == Shard(3, 5) and in_array(slurm)
    with pytest.raises(ConfigError, match="gaps"):
        shard_of("auto", {**slurm, "SLURM_ARRAY_TASK_COUNT": "4"})
    aws = {"AWS_BATCH_JOB_ARRAY_INDEX": "0", "AWS_BATCH_JOB_ARRAY_SIZE": "8"}
    assert shard_of("auto", aws) == Shard(1, 8)
    for text, environment in (("auto", {}), ("auto", {"AWS_BATCH_JOB_ARRAY_INDEX": "x"}), ("9/8", {}), ("a/b", {})):
        with pytest.raises(ConfigError):
            shard_of(text, environment)


def test_manifest_of_ten_thousand_lines_is_read_line_by_line_once():
    """All settings of all lines are checked; nothing is quadratic in their number."""
    with Path("list.csv").open("w") as file:
        file.write("asset,name,size_mm,printer\n")
        file.writelines(f"in/{i}.glb,item{i},{50 + i % 50},fdm-0.2\n" for i in range(10_000))
    items = read_manifest("list.csv")
    require_names(items)
    works = {with_settings(Work(), item.settings).config.size_mm for item in items}
    assert len(items) == 10_000 and len(works) == 50

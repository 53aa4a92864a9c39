"""``genmf-mi merge``: totals, failures, the worst, and the table read back."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path

import pytest

from genmf_mi.batch.merge import WORST, gain, merge
from genmf_mi.cli import main as cli
from genmf_mi.core.errors import OutputError

pytestmark = pytest.mark.usefixtures("workplace")


def write(name: str, *records: dict) -> None:
    Path("out").mkdir(exist_ok=True)
    with Path("out", name).open("a") as file:
        file.writelines(json.dumps(record) + "\n" for record in records)


def part(name: str, after: float, ended: str = "1", **more) -> dict:
    scores = {"lpips_before": 0.2, "lpips": after, "ssim": 0.9}
    return {
        "name": name,
        "state": "refined",
        "scores": scores,
        "seconds": 10,
        "cpu_seconds": 36,
        "ended": ended,
        **more,
    }


def test_all_shards_together(capsys):
    write("outcomes-1-of-2.jsonl", {"batch": "1/2", "items": 3, "time": "1"}, part("a", 0.1, warnings=["thin", "old"]),
          {"name": "b", "state": "failed", "cause": "solid", "error": "it is open.\nmore", "ended": "1"},
          {"name": "c", "state": "failed", "cause": "crash", "ended": "1"}, part("c", 0.19, "2"))  # fmt: skip
    write("outcomes-2-of-2.jsonl", {"batch": "2/2", "items": 3, "time": "2"}, part("d,1", 0.21),
          {"name": "e", "state": "duplicate", "of": "a", "ended": "1"}, {"torn": 1})  # fmt: skip
    with Path("out/outcomes-2-of-2.jsonl").open("a") as file:
        file.write('{"name": "x", "sta')
    merged = merge("out")
    assert merged.states == {"refined": 3, "failed": 1, "duplicate": 1} and merged.causes == {"solid": 1}
    assert merged.expected == 6 and merged.missing == 1
    assert [one.name for one in merged.worst] == ["d,1", "c", "a"] and gain(merged.worst[-1]) == pytest.approx(50)
    assert ("CPU hours", "0.03") in merged.totals()
    rows = {row["name"]: row for row in csv.DictReader(Path("out/outcomes.csv").read_text().splitlines())}
    assert set(rows) == {"a", "b", "c", "d,1", "e"} and rows["c"]["lpips"] == "0.19"
    assert rows["a"]["warnings"] == "thin; old" and rows["e"]["of"] == "a"
    assert cli.main(["merge", "out"]) == 1
    printed = capsys.readouterr().out
    assert "items: 5 of 6" in printed and "failed by solid: 1, such as b: it is open." in printed
    assert "1 items have no outcome yet" in printed and "gallery.html" in printed


def test_page_holds_every_item_and_escapes_what_they_say():
    bad = "</script><script>alert(1)</script>"
    write("outcomes.jsonl", {"batch": "1/1", "items": 2, "time": "1"}, part("a b#", 0.1),
          {"name": "z", "state": "failed", "cause": "asset", "error": bad, "ended": "1"})  # fmt: skip
    merge("out")
    page = Path("out/gallery.html").read_text()
    assert bad not in page and not re.findall(r'(?:src|href)="http', page)
    data = json.loads(re.search(r'<script id="data" type="application/json">(.*?)</script>', page)[1])  # type: ignore
    first, second = data["parts"]
    assert first["picture"] == "a%20b%23/thumbnail.jpg" and first["scores"]["gain"] == 50.0
    assert second["text"] == bad and "picture" not in second


def test_other_division_into_shards_counts_anew():
    write("outcomes-1-of-2.jsonl", {"batch": "1/2", "items": 9, "time": "1"})
    write("outcomes.jsonl", {"batch": "1/1", "items": 2, "time": "2"}, part("a", 0.1), part("b", 0.1))
    assert merge("out").missing == 0
    assert cli.main(["merge", "out"]) == 0


def test_worst_twenty():
    write("outcomes.jsonl", *(part(f"p{i}", 0.001 * i) for i in range(30)))
    assert [one.name for one in merge("out").worst] == [f"p{i}" for i in range(29, 29 - WORST, -1)]


def test_nothing_to_merge():
    with pytest.raises(OutputError, match="no outcomes of a batch"):
        merge("nowhere")

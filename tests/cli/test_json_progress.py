"""Progress for programs: lines of JSON."""

from __future__ import annotations

import json
import time

from genmf_mi.cli import refine as command
from genmf_mi.cli.progress import JsonProgress


def lines(capsys) -> list[dict]:
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def test_every_call_is_a_line(capsys):
    progress, before = JsonProgress(), time.time()
    progress.stage("refining")
    progress.advance(1, 4, {"loss": 0.5, "stress": float("nan")})  # JSON has no NaN
    progress.advance(0.25, 1.0)
    progress.warn("Mind the gap.")
    said = lines(capsys)
    assert all(before - 0.01 <= line.pop("at") <= time.time() + 0.01 for line in said)
    assert said == [
        {"stage": "refining"},
        {"done": 1, "total": 4, "values": {"loss": 0.5}},
        {"done": 0.25, "total": 1.0, "values": {}},
        {"warning": "Mind the gap."},
    ]


def test_refine_prints_nothing_else(capsys, monkeypatch):
    from genmf_mi.pipeline import refinement

    def stand_in(asset, config, *, progress, **options):
        progress.stage(asset)
        return type("Result", (), {"metrics": {}})

    monkeypatch.setattr(refinement, "refine", stand_in)
    assert command.main(["toy.glb", "--json-progress"]) == 0
    (line,) = lines(capsys)
    assert line["stage"] == "toy.glb"

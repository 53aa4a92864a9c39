"""The loss curves of the report."""

from __future__ import annotations

import dataclasses
import re

import pytest

from genmf_mi.report import curves
from genmf_mi.report.page import render


def points(path: str) -> list[list[tuple[float, float]]]:
    strokes = [re.split("L", stroke) for stroke in path.split("M")[1:]]
    return [[tuple(map(float, point.split())) for point in stroke] for stroke in strokes]


def test_curve_passes_through_the_values(report):
    loss, lpips = curves.curves(report.history)
    assert (loss.name, lpips.name) == ("loss", "lpips")
    (stroke,) = points(lpips.raw)
    ticks = {label: y for y, label in lpips.ticks}
    assert ticks["0"] == curves.HEIGHT
    for i, (x, y) in enumerate(stroke):
        assert x == pytest.approx(curves.WIDTH * i / 39, abs=0.06)
        assert (curves.HEIGHT - y) / (curves.HEIGHT - ticks["0.5"]) == pytest.approx((1 - 0.02 * i) / 0.5, abs=0.03)
    assert lpips.stages == [(pytest.approx(curves.WIDTH * 25 / 39), "2")]


def test_terms_of_the_second_stage_are_drawn(report):
    history = [{**row, "stress_band": 1.1 - 0.001 * i} if row["stage"] == 2 else row
               for i, row in enumerate(report.history)]  # fmt: skip
    (curve,) = [c for c in curves.curves(history) if c.name == "stress_band"]
    (stroke,) = points(curve.raw)
    assert len(stroke) == 15 and stroke[0][0] == pytest.approx(curve.stages[0][0], abs=0.06)
    assert "predicted stress, surface band" in render(dataclasses.replace(report, history=history))


def test_curve_keeps_gaps_and_stays_in_the_frame():
    values = [1.0, 2.0, None, float("nan"), 2.0, 1.5, 900.0, 0.001]
    (curve,) = curves.curves([{"iteration": i, "loss": value} for i, value in enumerate(values)])
    strokes = points(curve.raw)
    assert [len(stroke) for stroke in strokes] == [2, 4]
    assert curve.logarithmic and all(0 <= y <= curves.HEIGHT for stroke in strokes for _, y in stroke)


def test_long_history_is_thinned():
    (curve,) = curves.curves([{"iteration": i, "loss": 1.0} for i in range(5000)])
    assert sum(map(len, points(curve.raw))) <= 300 and curve.iterations == (0, 4999)

"""Key numbers and notes of the report."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from toy_report import METRICS

from genmf_mi.report import Report, tables
from genmf_mi.report.page import render
from genmf_mi.report.summary import notes, tiles


def with_metrics(report: Report, **metrics: object) -> Report:
    return dataclasses.replace(report, metrics={**METRICS, **metrics})


def test_key_numbers_judge_by_direction(report):
    lpips, ssim, unseen, relief, solid, time = tiles(report)
    assert (lpips.value, lpips.good, lpips.details[0]) == ("0.2257 → 0.1418", True, "−0.0839 (−37 %), better")
    assert (ssim.value, ssim.good) == ("0.7988 → 0.8253", True)
    assert (unseen.value, unseen.details[1]) == ("0.2010 → 0.1344", "luminance displacement: –")
    assert (relief.value, relief.good) == ("0.93\N{NO-BREAK SPACE}mm", True)
    assert (solid.value, time.value) == ("watertight", "2 min 23 s")
    deep = {**METRICS, "relief_mm": {"max": 1.2}, "solid": {"watertight": False, "self_intersections": 7}}
    worse = dataclasses.replace(report, metrics=deep)
    assert [tile.good for tile in tiles(worse)[3:5]] == [False, False]
    assert len(notes(worse)) == len(notes(report)) + 2


@pytest.mark.parametrize(
    ("seconds", "shown"),
    [
        ({"total": 106.1, "load": 1.1, "optimise": 84.0, "evaluate": 4.8}, "1 min 47 s"),
        ({"load": 1.5, "optimise": 40.0}, "41.5 s"),
        ({"total": None, "load": np.float64(2.0)}, "2.0 s"),
        ({"total": float("nan")}, tables.DASH),
        ({}, tables.DASH),
        (None, tables.DASH),
    ],
)
def test_time_is_shown_before_the_writing_is_timed(report, seconds, shown):
    """The report is written before the run ends: its metrics lack ``write``, and perhaps the total."""
    timed = with_metrics(report, seconds=seconds)
    assert tiles(timed)[-1].value == shown
    assert f'<dt>Time</dt><dd class="value">{shown}</dd>' in render(timed)


def test_notes_tell_of_relief_that_was_taken_back(report):
    (note,) = set(notes(with_metrics(report, relief_backed_off=0.034))) - set(notes(report))
    assert note == "The relief was taken back on 3 % of the surface, where it would have cut through itself."
    for share in (0.0, 0.01, None, float("nan")):
        assert notes(with_metrics(report, relief_backed_off=share)) == notes(report)


def test_notes_tell_of_gradients_that_are_not_finite(report):
    (note,) = set(notes(with_metrics(report, nonfinite_gradients=12))) - set(notes(report))
    assert note.startswith("The gradients of 12 vertices") and "not finite" in note and "report the asset" in note
    for count in (0, None):
        assert notes(with_metrics(report, nonfinite_gradients=count)) == notes(report)

"""Metrics as text and tables."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from lxml import html
from toy_report import METRICS

from genmf_mi.report import tables
from genmf_mi.report.page import render


def test_metrics_are_put_side_by_side_wherever_the_state_stands():
    inside = {"before": {"inside": {"ssim": 0.5}}, "after": {"inside": {"ssim": 0.4}}}
    found, rest = tables.compare({**inside, "unseen.before": {"ssim": 0.6}, "seconds": {"displacement": 2.0}})
    assert [(table.group, table.states) for table in found] == [
        (("inside",), ["before", "after"]),
        (("unseen",), ["before"]),
    ]
    assert found[0].rows == [("SSIM", ["0.5000", "0.4000"], "−0.1000 (−20 %), worse")]
    assert rest == [("seconds · displacement", "2\N{NO-BREAK SPACE}s")]


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (None, "–"),
        (True, "yes"),
        (np.bool_(False), "no"),
        (160000, "160000"),
        (0.2257, "0.2257"),
        (100.0, "100"),
        (812345.6, "812346"),
        (1e-7, "1e-07"),
        (np.float32("nan"), "–"),
        ([1, 0.5], "1, 0.5"),
        (np.arange(2), "0, 1"),
    ],
)
def test_values_as_text(value, expected):
    assert tables.text(value) == expected


def summary(p99_9: float, mean: float, band: float) -> dict:
    return {
        "von_mises_mpa": {"p99_9": p99_9, "mean": mean, "max": 9.0},
        "surface_band": {"mean": band, "p99_9": 2 * band},
    }


def verified() -> dict:
    """Metrics of a run with its three shapes simulated, and the ratios of the verification."""
    shapes = {"before": (1.0, 0.4, 0.5), "unconstrained": (2.0, 0.44, 0.6), "after": (1.5, 0.42, 0.55)}
    keys = [key for key, *_ in tables.STRESSES]
    return {
        **METRICS,
        "unconstrained": {"ssim": 0.83, "lpips_alex": 0.1257, "g_ssim": 0.78},
        "stress": {
            "shapes": {name: summary(*values) for name, values in shapes.items()},
            "ratio": {
                "unconstrained": dict(zip(keys, (2.0, 1.1, 1.2, 1.2))),
                "after": dict(zip(keys, (1.5, 1.05, 1.1, 1.1))),
                "constrained": dict(zip(keys, (0.75, 0.9545, 0.9167, 0.9167))),
            },
            "remains": dict(zip(keys, (0.5, 0.5, None, 0.5))),
        },
    }


def test_stress_is_shown_next_to_lpips(report):
    """In its own table, and nowhere else."""
    table = tables.stress(verified())
    assert table
    assert table.columns[1:4] == ["Before", "Without stress stage", "Refined"]
    assert table.rows[0][1:] == ["1.000", "2.000 ×2.00", "1.500 ×1.50", "×0.75", "50 %"]
    assert table.rows[2][-1] == tables.DASH
    assert table.rows[-1] == ["LPIPS (AlexNet)", "0.2257", "0.1257", "0.1418", "×1.13", "84 % kept"]
    text = render(dataclasses.replace(report, metrics=verified()))
    page = html.document_fromstring(text)
    (section,) = page.xpath("//section[@aria-labelledby='h-stress']")
    assert len(section.xpath(".//tbody/tr")) == 5 and "2.000 ×2.00" in section.text_content()
    assert page.xpath("//table[caption='Standard views, full frame']//th/text()")[:5] == [
        "Metric", "Before", "Displacement", "Without stress stage", "Refined"]  # fmt: skip
    assert "von mises" not in text
    assert not html.document_fromstring(render(report)).xpath("//*[@id='h-stress']")


def test_stress_without_a_stress_stage():
    metrics = verified()
    for place in (metrics, metrics["stress"]["shapes"], metrics["stress"]["ratio"]):
        del place["unconstrained"]
    del metrics["stress"]["ratio"]["constrained"], metrics["stress"]["remains"]
    table = tables.stress(metrics)
    assert table
    assert table.columns == ["", "Before", "Refined"]
    assert table.rows[0][1:] == ["1.000", "1.500 ×1.50"] and table.rows[-1][1:] == ["0.2257", "0.1418"]
    assert tables.stress(METRICS) is None
    assert tables.stress({"stress": {"shapes": {"after": {}}}}) is None

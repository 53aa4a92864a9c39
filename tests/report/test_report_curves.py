"""The loss curves of the report."""

from __future__ import annotations

import dataclasses
import re
import time

import numpy as np
import pytest
from lxml import html

from genmf_mi.report import curves, tables
from genmf_mi.report.page import render


def strokes(curve: curves.Curve, line: str = "raw") -> list[np.ndarray]:
    """Points ``[N,2]`` of each stroke of a line, in SVG units."""
    (path,) = html.fromstring(curve.svg).xpath(f"//path[@class='{line}']/@d")
    assert not re.search(r"[^MLh\d. ]", path)
    points = [re.split("L", stroke.removesuffix("h0")) for stroke in path.split("M")[1:]]
    return [np.array([point.split() for point in stroke], dtype=float) for stroke in points]


def ticks(curve: curves.Curve) -> dict[str, float]:
    """Heights of the grid lines by their labels."""
    svg = html.fromstring(curve.svg)
    labels = svg.xpath("//text[@text-anchor='end']/text()")
    lines = [float(re.split("[ L]", path)[1]) for path in svg.xpath("//path[@class='grid']/@d")]
    assert len(labels) == len(lines)
    return dict(zip(labels, lines))


def x(share: float) -> float:
    return curves.LEFT + (curves.RIGHT - curves.LEFT) * share


def test_curve_passes_through_the_values(report):
    loss, lpips = curves.curves(report.history)
    assert (loss.name, lpips.name, loss.stages) == ("loss", "lpips", ["2"])
    (stroke,) = strokes(lpips)
    y = ticks(lpips)
    assert y["0"] == curves.BOTTOM
    np.testing.assert_allclose(stroke[:, 0], [x(i / 39) for i in range(40)], atol=0.06)
    values = (y["0"] - stroke[:, 1]) / (y["0"] - y["0.5"]) * 0.5
    np.testing.assert_allclose(values, [row["lpips"] for row in report.history], atol=0.002)
    (start,) = strokes(lpips, "stage")
    assert start[0, 0] == pytest.approx(x(25 / 39), abs=0.06)
    assert "stage 2" in html.fromstring(lpips.svg).xpath("//text/text()")


def test_thick_line_is_the_running_median():
    """A spike moves the thin line only; first and last are medians of a twentieth of the values."""
    history = [{"iteration": i, "loss": 900.0 if i == 30 else 3.0 if i < 20 else 2.0} for i in range(60)]
    (curve,) = curves.curves(history)
    assert (curve.first, curve.last, curve.logarithmic) == (3.0, 2.0, True)
    (raw,), (smooth,) = strokes(curve), strokes(curve, "smooth")
    assert raw[30, 1] == curves.TOP and smooth[30, 1] == smooth[50, 1] == curves.BOTTOM
    assert smooth[0, 1] < smooth[50, 1]


def test_logarithmic_axis_has_ticks_where_the_values_are():
    (curve,) = curves.curves([{"iteration": i, "loss": 0.001 * 2.0**i} for i in range(10)])
    y = ticks(curve)
    assert curve.logarithmic and list(y) == ["0.001", "0.003", "0.01", "0.03", "0.1", "0.3"]
    assert y["0.01"] - y["0.1"] == pytest.approx(y["0.001"] - y["0.01"], abs=0.2)
    (stroke,) = strokes(curve)
    np.testing.assert_allclose(np.diff(stroke[:, 1]), (curves.TOP - curves.BOTTOM) / 9, atol=0.11)


def test_terms_of_the_second_stage_are_drawn(report):
    history = [{**row, "stress_band": 1.1 - 0.001 * i} if row["stage"] == 2 else row
               for i, row in enumerate(report.history)]  # fmt: skip
    (curve,) = [c for c in curves.curves(history) if c.name == "stress_band"]
    (stroke,) = strokes(curve)
    assert len(stroke) == 15 and stroke[0, 0] == strokes(curve, "stage")[0][0, 0]
    assert "predicted stress, surface band" in render(dataclasses.replace(report, history=history))


def test_curve_keeps_gaps_and_stays_in_the_frame():
    values = [1.0, 2.0, None, float("nan"), 2.0, 1.5, 900.0, 0.001, None, 1.0]
    (curve,) = curves.curves([{"iteration": i, "loss": value} for i, value in enumerate(values)])
    found = strokes(curve)
    assert [len(stroke) for stroke in found] == [2, 4, 1]
    assert curve.logarithmic
    for stroke in found:
        assert ((stroke[:, 1] >= curves.TOP) & (stroke[:, 1] <= curves.BOTTOM)).all()


def test_value_between_gaps_is_a_dot():
    """A term that is known every few iterations only must not vanish."""
    history = [{"iteration": i, "loss": 1.0, "stress": 2.0 if i % 10 == 0 else None} for i in range(35)]
    curve = curves.curves(history)[1]
    assert [len(stroke) for stroke in strokes(curve)] == [1] * 4
    assert len(re.findall(r"M[\d. ]+h0", html.fromstring(curve.svg).xpath("//path[@class='raw']/@d")[0])) == 4


def test_long_history_is_thinned():
    (curve,) = curves.curves([{"iteration": i, "loss": 1.0} for i in range(5000)])
    assert len(strokes(curve)[0]) == 300 and "iterations 0 to 4999" in curve.svg


def test_drawings_fit_into_a_page(report, monkeypatch):
    """No ids, no references, no styles of their own, and a text for those who cannot see them."""
    history = [{**row, "<b>$x^2$": 0.5, "stage": f"{row['stage']} <i>$y_1$"} for row in report.history]
    text = render(dataclasses.replace(report, history=history))
    svgs = html.document_fromstring(text).xpath("//figure/svg")
    assert len(svgs) == 3
    for svg in svgs:
        assert {element.tag for element in svg.iter()} == {"svg", "path", "text"}
        assert not svg.xpath(".//@id | .//@style | .//@href | .//@transform | .//@clip-path")
        assert {path.get("class") for path in svg.iter("path")} == {"raw", "smooth", "grid", "stage"}
        assert svg.get("role") == "img" and "iterations 0 to 39" in svg.get("aria-label")
        assert svg.xpath("./text[.='stage 2 <i>$y_1$']")
    assert svgs[2].get("aria-label").startswith("<b>$x^2$, ")


def test_page_does_not_depend_on_the_matplotlibrc(report):
    import matplotlib

    drawn = curves.curves(report.history)
    with matplotlib.rc_context({"svg.fonttype": "path", "axes.grid.axis": "x", "xtick.top": True, "font.size": 30}):
        assert curves.curves(report.history) == drawn


def test_terms_have_names_for_people():
    assert tables.label("ssim") == "SSIM" and tables.term("ssim") == "1 − SSIM"
    for name in ("loss", "grey_lpips", "gradient_ssim", "normal_flip", "sdf_tv", "l_dev", "flexi_weight_reg", "stress"):
        assert tables.term(name) != name.replace("_", " ")


def test_nothing_to_draw():
    assert curves.curves([]) == []
    assert curves.curves([{"iteration": 0, "stage": 1, "loss": None}]) == []


@pytest.mark.parametrize("value", [0.0, -3.0, 1e-20, 5e4])
def test_constant_and_single_values(value):
    (curve,) = curves.curves([{"iteration": 7, "loss": value}])
    assert (curve.first, curve.last) == (value, value)
    assert [len(stroke) for stroke in strokes(curve)] == [1]


def test_curves_of_a_run_are_drawn_in_two_seconds():
    rng = np.random.default_rng(0)
    history = [{"iteration": i} | {f"term{k}": v for k, v in enumerate(rng.random(18))} for i in range(250)]
    curves.curves(history[:2])  # imports matplotlib
    start = time.process_time()
    drawn = curves.curves(history)
    assert time.process_time() - start < 2
    assert len(drawn) == 18 and sum(len(curve.svg) for curve in drawn) < 18 * 8000

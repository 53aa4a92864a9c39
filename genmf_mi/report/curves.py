"""Loss curves: one small SVG per term, drawn by matplotlib and styled by the page."""

from __future__ import annotations

import io
import math
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING
from xml.etree import ElementTree

import numpy as np
from markupsafe import Markup

from genmf_mi.report import tables

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH, HEIGHT = 356, 156
"""Size of a drawing in SVG units, about one pixel of the page each."""
LEFT, TOP, RIGHT, BOTTOM = 46, 16, 340, 136
"""The plotting area of a drawing in SVG units."""

_POINTS = 300
_NOT_A_TERM = ("iteration", "stage", "seconds", "gradient_scale")
_SVG = "{http://www.w3.org/2000/svg}"


@dataclass(frozen=True)
class Curve:
    """One loss term over the iterations.

    svg: an ``<svg>`` element whose paths have the classes ``raw`` (the values), ``smooth`` (their running median),
        ``grid`` (ticks) and ``stage`` (where a stage begins, the first one left out). The style sheet of the page
        gives colours, line widths and the font.
    stages: names of the stages that begin after the first iteration.
    first, last: medians of the first and the last twentieth of the values.
    logarithmic: whether the vertical axis is.
    """

    name: str
    svg: Markup
    stages: list[str]
    first: float
    last: float
    logarithmic: bool


def curves(history: list[dict]) -> list[Curve]:
    """One curve per loss term that has a finite value, ``loss`` (the sum) first, the others in order of appearance.

    Terms may be missing from some iterations; gaps stay gaps. The axis is logarithmic where a term spans more than a
    factor of twenty.
    """
    names = dict.fromkeys(name for row in history for name in row if name not in _NOT_A_TERM)
    if not names:
        return []
    from matplotlib import style

    # From matplotlib's own defaults, as a user's matplotlibrc must not change the page
    with style.context(["default", {"svg.fonttype": "none", "path.simplify": False}]):
        drawn = [_curve(name, history) for name in sorted(names, key=lambda name: name != "loss")]
    return [curve for curve in drawn if curve is not None]


def _curve(name: str, history: list[dict]) -> Curve | None:
    from matplotlib.figure import Figure

    iteration = np.array([row.get("iteration", index) for index, row in enumerate(history)], dtype=float)
    values = np.array([_number(row.get(name)) for row in history])
    finite = np.isfinite(values)
    if not finite.any():
        return None
    known = values[finite]
    window = max(1, len(known) // 20)
    median = np.full_like(values, np.nan)
    median[finite] = [np.median(known[max(0, i - window) : i + window + 1]) for i in range(len(known))]
    first, last = float(np.median(known[:window])), float(np.median(known[-window:]))
    logarithmic = bool(known.min() > 0 and known.max() > 20 * known.min())
    stages = [
        (float(iteration[i]), str(history[i]["stage"]))
        for i in range(1, len(history))
        if history[i].get("stage") != history[i - 1].get("stage") and history[i].get("stage") is not None
    ]

    figure = Figure((WIDTH / 72, HEIGHT / 72), frameon=False)  # an SVG unit is a point, 1/72 inch
    axes = _axes(figure, (iteration[0], max(iteration[-1], iteration[0] + 1)), _limits(known, logarithmic), logarithmic)
    for start, stage in stages:
        axes.axvline(start, gid="stage", clip_on=False)
        label = f"stage {stage}"
        axes.annotate(
            label, (start, 1), (0, 4), ("data", "axes fraction"), "offset points", ha="center", parse_math=False
        )
    thinned = np.unique(np.linspace(0, len(values) - 1, min(len(values), _POINTS)).round().astype(int))
    for line, points in (("raw", values), ("smooth", median)):
        axes.plot(iteration[thinned], np.clip(points[thinned], *axes.get_ylim()), gid=line, clip_on=False)
    description = (
        f"{tables.term(name)}, iterations {iteration[0]:.0f} to {iteration[-1]:.0f}: "
        f"{first:.3g} at first, {last:.3g} at the end"
    )
    return Curve(name, _inline_svg(figure, description), [stage for _, stage in stages], first, last, logarithmic)


def _number(value: object) -> float:
    return float(value) if isinstance(value, (int, float, np.number)) else math.nan


def _limits(values: np.ndarray, logarithmic: bool) -> tuple[float, float]:
    """Range of the vertical axis; a linear one holds 0."""
    if logarithmic:
        return float(values.min()), float(values.max())
    # A single spike must not flatten the rest
    high = max(float(np.quantile(values, 0.995)) * 1.05, 0.0)
    low = min(float(values.min()) * 1.05, 0.0)
    return low, high if high - low > 1e-12 else low + 1.0


def _axes(figure: Figure, x_limits: tuple[float, float], y_limits: tuple[float, float], logarithmic: bool) -> Axes:
    """Empty axes without a frame, with a line across at each tick of the vertical axis."""
    from matplotlib.ticker import LogLocator, MaxNLocator

    axes = figure.add_axes(
        (LEFT / WIDTH, 1 - BOTTOM / HEIGHT, (RIGHT - LEFT) / WIDTH, (BOTTOM - TOP) / HEIGHT), frame_on=False
    )
    axes.set(xlim=x_limits, yscale="log" if logarithmic else "linear", ylim=y_limits)
    axes.xaxis.set_major_locator(MaxNLocator(6, steps=(1, 2, 5, 10), integer=True))
    if logarithmic:
        within_decades = (1, 3) if y_limits[1] < 1000 * y_limits[0] else (1,)
        axes.yaxis.set_major_locator(LogLocator(subs=within_decades, numticks=6))
    else:
        axes.yaxis.set_major_locator(MaxNLocator(5, steps=(1, 2, 5, 10)))
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:.3g}")
    axes.minorticks_off()
    axes.tick_params(left=False, bottom=False)
    axes.grid(axis="y")
    return axes


def _inline_svg(figure: Figure, description: str) -> Markup:
    """The drawing as part of a page: geometry and texts only.

    Ids, which would collide on a page with many drawings, as well as fonts, colours and metadata are left out.
    """
    buffer = io.BytesIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None})
    parts = [Markup('<svg viewBox="0 0 {} {}" role="img" aria-label="{}">').format(WIDTH, HEIGHT, description)]
    for group in ElementTree.fromstring(buffer.getvalue()).iter(f"{_SVG}g"):
        gid = group.get("id")
        for path in group.findall(f"{_SVG}path"):
            line = gid if gid in ("raw", "smooth", "stage") else "grid"
            parts.append(Markup('<path class="{}" d="{}"/>').format(line, _compact(path.get("d", ""))))
        for text in group.findall(f"{_SVG}text"):
            anchor = re.search(r"text-anchor: (\w+)", text.get("style", ""))
            x, y = (_compact(text.get(axis, "0")) for axis in "xy")
            parts.append(
                Markup('<text x="{}" y="{}" text-anchor="{}">{}</text>').format(
                    x, y, anchor[1] if anchor else "start", text.text or ""
                )
            )
    return Markup("").join([*parts, Markup("</svg>")])


def _compact(geometry: str) -> str:
    """SVG path data to a tenth of a unit, without white space that is not needed."""
    tenths = re.sub(r"\d+\.\d+", lambda number: f"{float(number[0]):.1f}".removesuffix(".0"), geometry)
    dense = re.sub(r"\s*([ML])\s*", r"\1", tenths).strip()
    # A point between two gaps becomes a line of no length, which shows as a dot
    return re.sub(r"(M[^ML]+)(?=M|$)", r"\1h0", dense)

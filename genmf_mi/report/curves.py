"""Loss curves as SVG path data; the page draws them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

WIDTH, HEIGHT = 300, 120
"""Size of the plotting area in SVG units."""

_POINTS = 300
_NOT_A_TERM = ("iteration", "stage", "seconds", "gradient_scale")


@dataclass(frozen=True)
class Curve:
    """One loss term over the iterations.

    raw, smooth: SVG path data of the values and of their running median.
    ticks: (y in SVG units, label) of the vertical axis.
    stages: (x in SVG units, name) where a stage begins, the first one left out.
    first, last: medians of the first and the last twentieth of the values.
    """

    name: str
    raw: str
    smooth: str
    ticks: list[tuple[float, str]]
    stages: list[tuple[float, str]]
    first: float
    last: float
    iterations: tuple[int, int]
    logarithmic: bool


def curves(history: list[dict]) -> list[Curve]:
    """One curve per loss term that has a finite value, ``loss`` (the sum) first, the others in order of appearance.

    Terms may be missing from some iterations; gaps stay gaps. The axis is logarithmic where a term spans more than a
    factor of twenty.
    """
    names = dict.fromkeys(name for row in history for name in row if name not in _NOT_A_TERM)
    ordered = sorted(names, key=lambda name: name != "loss")
    drawn = (_curve(name, history) for name in ordered)
    return [curve for curve in drawn if curve is not None]


def _curve(name: str, history: list[dict]) -> Curve | None:
    iteration = np.array([row.get("iteration", index) for index, row in enumerate(history)], dtype=float)
    values = np.array([_number(row.get(name)) for row in history])
    finite = np.isfinite(values)
    if not finite.any():
        return None
    known = values[finite]
    window = max(1, len(known) // 20)
    median = np.array([np.median(known[max(0, i - window) : i + window + 1]) for i in range(len(known))])
    smooth = np.full_like(values, np.nan)
    smooth[finite] = median

    logarithmic = bool(known.min() > 0 and known.max() > 20 * known.min())
    low, high, ticks = _axis(known, logarithmic)
    start, end = iteration[0], max(iteration[-1], iteration[0] + 1)

    def x(at):
        return WIDTH * (at - start) / (end - start)

    def y(at):
        share = np.log(at / low) / math.log(high / low) if logarithmic else (at - low) / (high - low)
        return HEIGHT * (1 - share)

    return Curve(
        name=name,
        raw=_path(x(iteration), y(values)),
        smooth=_path(x(iteration), y(smooth)),
        ticks=[(float(y(tick)), f"{tick:.3g}") for tick in ticks],
        stages=[
            (float(x(iteration[i])), str(history[i]["stage"]))
            for i in range(1, len(history))
            if history[i].get("stage") != history[i - 1].get("stage") and history[i].get("stage") is not None
        ],
        first=float(np.median(known[:window])),
        last=float(np.median(known[-window:])),
        iterations=(int(iteration[0]), int(iteration[-1])),
        logarithmic=logarithmic,
    )


def _number(value: object) -> float:
    return float(value) if isinstance(value, (int, float, np.number)) else math.nan


def _axis(values: np.ndarray, logarithmic: bool) -> tuple[float, float, list[float]]:
    """Range of the axis and its ticks."""
    if logarithmic:
        low, high = float(values.min()), float(values.max())
        decades = range(math.ceil(math.log10(low) - 1e-9), math.floor(math.log10(high) + 1e-9) + 1)
        return low, high, [10.0**decade for decade in decades][:6] or [low, high]
    # A single spike must not flatten the rest
    high = max(float(np.quantile(values, 0.995)) * 1.05, 0.0)
    low = min(float(values.min()) * 1.05, 0.0)
    if high - low < 1e-12:
        high = low + 1.0
    step = 10.0 ** math.floor(math.log10(high - low))
    step *= next(factor for factor in (0.2, 0.5, 1, 2) if (high - low) / (step * factor) <= 5)
    return low, high, [step * k for k in range(math.ceil(low / step), math.floor(high / step + 1e-9) + 1)]


def _path(x: np.ndarray, y: np.ndarray) -> str:
    """SVG path through the finite points, broken at the others, thinned to at most ``_POINTS`` points."""
    parts, pen = [], "M"
    for i in np.unique(np.linspace(0, len(x) - 1, min(len(x), _POINTS)).round().astype(int)):
        if not np.isfinite(y[i]):
            pen = "M"
            continue
        parts.append(f"{pen}{x[i]:.1f} {min(max(y[i], 0), HEIGHT):.1f}")
        pen = "L"
    return "".join(parts)

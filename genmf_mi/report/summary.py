"""What to know first: the key numbers of a run, and what to mind when printing."""

from __future__ import annotations

import math
from dataclasses import dataclass

from genmf_mi.report import tables
from genmf_mi.report.model import Report
from genmf_mi.report.remarks import remarks

NOTICEABLE_BACK_OFF = 0.01
"""A note says how much relief was taken back where it is more than this share of the surface."""


@dataclass(frozen=True)
class Tile:
    """A key number at the top of the page. ``good`` is None where the number is neither good nor bad."""

    name: str
    value: str
    details: list[str]
    good: bool | None = None


def tiles(report: Report) -> list[Tile]:
    """The numbers to look at first."""
    flat = {".".join(path): value for path, value in tables.flatten(report.metrics)}
    relief, watertight = flat.get("relief_mm.max"), flat.get("solid.watertight")
    return [
        _comparison_tile("Perceptual distance (LPIPS)", flat, "", "lpips_alex"),
        _comparison_tile("Structural similarity (SSIM)", flat, "", "ssim"),
        _comparison_tile("LPIPS, views and lights not optimised for", flat, "unseen.", "lpips_alex"),
        Tile(
            "Largest relief",
            _mm(relief),
            [
                f"of {_mm(report.cap_mm)} allowed",
                f"99 % below {_mm(flat.get('relief_mm.p99'))}, mean {_mm(flat.get('relief_mm.mean'))}",
            ],
            bool(relief <= report.cap_mm * (1 + 1e-6)) if tables.is_finite(relief) else None,
        ),
        Tile(
            "Solid",
            tables.DASH if watertight is None else "watertight" if watertight else "not watertight",
            [
                f"components: {tables.text(flat.get('solid.bodies'))}, "
                f"self-intersections: {tables.text(flat.get('solid.self_intersections'))}",
                f"volume: {tables.with_unit(('volume_mm3',), flat.get('solid.volume_mm3'))}",
            ],
            None if watertight is None else bool(watertight),
        ),
        Tile("Time", _duration(_total_seconds(report.metrics)), [f"iterations: {tables.text(flat.get('iterations'))}"]),
    ]


def notes(report: Report) -> list[str]:
    """What to mind when printing."""
    flat = {path[-1]: value for path, value in tables.flatten(report.config) if path}
    metrics = {".".join(path): value for path, value in tables.flatten(report.metrics)}
    deepest, nozzle = metrics.get("relief_mm.max"), flat.get("nozzle_mm")
    written = [
        f"The print files are in millimetres with the longest side at {_mm(report.size_mm)} and the base on z = 0. "
        "Scaling the part in the slicer scales the relief with it: refine again for another size.",
        "Use a matt filament in a light or medium colour. Gloss, translucency and black hide relief.",
    ]
    if tables.is_finite(deepest) and deepest > 0:
        written.append(
            f"On upright walls the nozzle draws the relief. On tops it comes in steps of a layer: {_mm(deepest)} are "
            f"{max(1, round(deepest / 0.2))} layers of 0.2 mm or {max(1, round(deepest / 0.12))} of 0.12 mm. Stand the "
            "side that matters upright, and keep supports and the seam off it."
        )
    if tables.is_finite(nozzle):
        written.append(
            f"Relief finer than a nozzle of {_mm(nozzle)} was left out. Refine again with its size for a coarser one."
        )
    written.append(
        "The relief reads best under one main lamp, here from the upper left with a weaker one from the right. Light "
        "from the side makes it stronger, light from all around weaker: try the lamp of the 3D view."
    )
    written += remarks(report.metrics)
    if reason := metrics.get("stress_stage_left_out"):
        written.append(f"There was no stress stage: {reason}.")
    if metrics.get("solid.watertight") is False:
        written.append("The part is not watertight. Let the slicer repair it, and look at its preview layer by layer.")
    if tables.is_finite(intersecting := metrics.get("solid.self_intersections")) and intersecting > 0:
        written.append(
            f"{tables.text(intersecting)} pairs of faces intersect. Slicers unite them; look at the preview where the "
            "surface folds."
        )
    if tables.is_finite(share := metrics.get("relief_backed_off")) and share > NOTICEABLE_BACK_OFF:
        written.append(
            f"The relief was taken back on {tables.percent(share)} of the surface, where it would have cut through "
            "itself."
        )
    if tables.is_finite(count := metrics.get("nonfinite_gradients")) and count > 0:
        written.append(
            f"The gradients of {tables.text(count)} vertices, over all iterations, were not finite and were left out. "
            "The relief may be incomplete: please report the asset."
        )
    return written


def _comparison_tile(name: str, flat: dict, group: str, metric: str) -> Tile:
    before, between, after = (flat.get(f"{group}{state}.{metric}") for state in ("before", "displacement", "after"))
    change = tables.change(metric, before, after)
    good = {"better": True, "worse": False}.get(change.rsplit(" ", 1)[-1])
    return Tile(name, f"{_four(before)} → {_four(after)}", [change, f"luminance displacement: {_four(between)}"], good)


def _four(value: object) -> str:
    return f"{value:.4f}" if tables.is_finite(value) else tables.DASH


def _mm(value: object) -> str:
    return f"{float(f'{value:.3g}'):g}\N{NO-BREAK SPACE}mm" if tables.is_finite(value) else tables.DASH


def _total_seconds(metrics: dict) -> float | None:
    """Seconds of the run so far: what the metrics give as the total, or else the sum of the steps."""
    seconds = metrics.get("seconds")
    if not isinstance(seconds, dict):
        return None
    if tables.is_finite(total := seconds.get("total")):
        return total
    steps = [value for value in seconds.values() if tables.is_finite(value)]
    return sum(steps) if steps else None


def _duration(seconds: object) -> str:
    if not tables.is_finite(seconds):
        return tables.DASH
    minutes, rest = divmod(math.ceil(seconds), 60)
    return f"{minutes} min {rest} s" if minutes else f"{seconds:.1f} s"

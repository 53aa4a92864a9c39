"""``report.html``: one file that holds everything, opens without a network, and is the same for the same run."""

from __future__ import annotations

import math
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

from jinja2 import Environment, StrictUndefined
from markupsafe import Markup

from genmf_mi.core.errors import OutputError
from genmf_mi.core.files import write_text
from genmf_mi.report import curves, packing, tables
from genmf_mi.report.model import Report, View
from genmf_mi.report.pictures import (
    PLASTIC,
    RELIEF_COLOURS,
    by_change,
    compose,
    data_uri,
    framing,
    picture,
    relief_picture,
)

_SIDE = 480
"""Longest side of the pictures per view in pixels; larger images are reduced."""


@dataclass(frozen=True)
class Tile:
    """A key number at the top of the page. ``good`` is None where the number is neither good nor bad."""

    name: str
    value: str
    details: list[str]
    good: bool | None = None


@dataclass(frozen=True)
class Figure:
    """A picture with what a reader who cannot see it should know."""

    name: str
    alt: str
    uri: str
    width: int
    height: int


def write_report(path: str | Path, report: Report) -> None:
    """Write the report as one self-contained HTML file.

    Raises:
        OutputError: the report has no view, or the file cannot be written.
    """
    if not report.views:
        raise OutputError(f"cannot write {path}: there are no views to show. Render at least one view first.")
    write_text(path, render(report))


def render(report: Report) -> str:
    """The report as HTML text. All texts of the report are escaped."""
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    environment.filters["label"] = tables.label
    environment.filters["term"] = tables.term
    environment.filters["text"] = tables.text
    environment.filters["short"] = lambda value: f"{value:.3g}"
    comparisons, other = tables.compare({key: value for key, value in report.metrics.items() if key != "stress"})
    mesh = packing.pack(report)
    drawn = curves.curves(report.history)
    return environment.from_string(_file("page.html")).render(
        report=report,
        style=Markup(_file("page.css")),
        script=Markup(_file("viewer.js")),
        tiles=tiles(report),
        hero=_hero(by_change(report.views)[0]),
        views=[(view.label, _figures(view, report.cap_mm)) for view in report.views],
        comparisons=comparisons,
        other_metrics=other,
        stress=tables.stress(report.metrics),
        curves=drawn,
        samples=_samples(report.history, [curve.name for curve in drawn]),
        settings=[(".".join(path), tables.text(value)) for path, value in tables.flatten(report.config)],
        steps=tables.rows({key: value for key, value in report.steps.items() if not _is_log(value)}),
        step_logs=[(key, value) for key, value in report.steps.items() if _is_log(value)],
        notes=notes(report),
        mesh={**mesh.meta, "colours": RELIEF_COLOURS, "plastic": PLASTIC, "material": report.material},
        mesh_data=mesh.data,
        all_faces=len(report.faces),
        gradient=", ".join(RELIEF_COLOURS),
        cap=tables.text(float(report.cap_mm)),
    )


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
                f"bodies: {tables.text(flat.get('solid.bodies'))}, "
                f"self-intersections: {tables.text(flat.get('solid.self_intersections'))}",
                f"volume: {tables.with_unit(('volume_mm3',), flat.get('solid.volume_mm3'))}",
            ],
            watertight,
        ),
        Tile("Time", _duration(flat.get("seconds.total")), [f"iterations: {tables.text(flat.get('iterations'))}"]),
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
    if reason := metrics.get("stress_stage_left_out"):
        written.append(f"There was no stress stage: {reason}. Print it larger, or with thicker walls.")
    if metrics.get("solid.watertight") is False:
        written.append("The part is not watertight. Let the slicer repair it, and look at its preview layer by layer.")
    if tables.is_finite(crossed := metrics.get("solid.self_intersections")) and crossed > 0:
        written.append(
            f"{tables.text(crossed)} pairs of faces cross. Slicers unite them; look at the preview where the surface "
            "folds."
        )
    return written


def _comparison_tile(name: str, flat: dict, group: str, metric: str) -> Tile:
    before, between, after = (flat.get(f"{group}{state}.{metric}") for state in ("before", "displacement", "after"))
    change = tables.change(metric, before, after)
    good = {"better": True, "worse": False}.get(change.rsplit(" ", 1)[-1])
    return Tile(name, f"{_four(before)} → {_four(after)}", [change, f"luminance displacement: {_four(between)}"], good)


def _hero(view: View) -> list[Figure]:
    box = framing([view])
    size = _within((box[2] - box[0], box[3] - box[1]), 640, enlarge=True)
    captions = {
        "colour": ("Textured model", "The model in colour"),
        "before": ("Printed as it is", "The original shape in one colour"),
        "after": ("Refined", "The refined shape in one colour, with the texture as relief"),
    }
    return [
        _figure(name, f"{alt}, {view.label}", picture(view, kind, box, size)) for kind, (name, alt) in captions.items()
    ]


def _figures(view: View, cap_mm: float) -> list[Figure]:
    box = framing([view])
    size = _within((box[2] - box[0], box[3] - box[1]), _SIDE)
    kinds = {
        "colour": "Texture",
        "reference": "Target",
        "before": "Before",
        "displacement": "Displacement",
        "after": "Refined",
    }
    figures = [
        _figure(name, f"{name}, {view.label}", picture(view, kind, box, size))
        for kind, name in kinds.items()
        if getattr(view, kind) is not None
    ]
    relief = compose(relief_picture(view, cap_mm), view.coverage("after"), box, size)
    return [*figures, _figure("Relief in mm", f"Relief map, {view.label}: blue is sunken, red is raised", relief)]


def _figure(name: str, alt: str, image) -> Figure:
    return Figure(name, alt, data_uri(image), *image.size)


def _within(size: tuple[int, int], side: int, enlarge: bool = False) -> tuple[int, int]:
    factor = side / max(size)
    return size if factor >= 1 and not enlarge else (max(1, round(size[0] * factor)), max(1, round(size[1] * factor)))


def _samples(history: list[dict], names: list[str], count: int = 11) -> list[list[str]]:
    """A few iterations as table rows: the number of the iteration, then each of the terms."""
    last = len(history) - 1
    chosen = sorted({round(last * k / (count - 1)) for k in range(count)}) if history else []
    return [
        [tables.text(history[i].get("iteration", i)), *(tables.text(history[i].get(name)) for name in names)]
        for i in chosen
    ]


def _is_log(value: object) -> bool:
    return isinstance(value, (list, tuple)) and bool(value) and all(isinstance(line, str) for line in value)


def _four(value: object) -> str:
    return f"{value:.4f}" if tables.is_finite(value) else tables.DASH


def _mm(value: object) -> str:
    return f"{float(f'{value:.3g}'):g}\N{NO-BREAK SPACE}mm" if tables.is_finite(value) else tables.DASH


def _duration(seconds: object) -> str:
    if not tables.is_finite(seconds):
        return tables.DASH
    minutes, rest = divmod(math.ceil(seconds), 60)
    return f"{minutes} min {rest} s" if minutes else f"{seconds:.1f} s"


def _file(name: str) -> str:
    return resources.files(__package__).joinpath(name).read_text(encoding="utf-8")

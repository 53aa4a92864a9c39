"""``report.html``: one file that holds everything, opens without a network, and is the same for the same run."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import resources
from pathlib import Path

from jinja2 import Environment, StrictUndefined
from markupsafe import Markup
from PIL.Image import Image

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
from genmf_mi.report.regions import told
from genmf_mi.report.summary import notes, tiles

NOT_COMPARED = ("stress", "stand", "pieces", "asset_notes", "regions")
"""Entries of the metrics that are told elsewhere on the page."""
_SIDE = 480
"""Longest side of the pictures per view in pixels; larger images are reduced."""

MODULES = ("shaders.js", "geometry.js", "gestures.js", "viewer.js", "packed.js", "report.js")
"""Of the script in the page, each after what it imports."""


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
    comparisons, other = tables.compare({k: v for k, v in report.metrics.items() if k not in NOT_COMPARED})
    mesh = packing.pack(report)
    drawn = curves.curves(report.history)
    return environment.from_string(_file("page.html")).render(
        report=report,
        style=Markup(_file("page.css")),
        script=Markup(_script()),
        tiles=tiles(report),
        hero=_hero(by_change(report.views)[0]),
        views=[(view.label, _figures(view, report.cap_mm)) for view in report.views],
        as_printed=[(light, _printed(pictures, report)) for light, pictures in report.as_printed.items()],
        regions=[_figure(view, f"What was painted, {view}", picture) for view, picture in report.regions.items()],
        regions_told=told(report.metrics),
        comparisons=comparisons,
        other_metrics=other,
        stands=tables.stands(report.metrics),
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


def _printed(pictures: list[Image], report: Report) -> list[Figure]:
    """A row of pictures of the printed parts."""
    names = report.as_printed_names
    return [
        Figure(name, f"{report.title}, {name}", data_uri(picture), *picture.size)
        for name, picture in zip(names, pictures, strict=True)
    ]


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


def _figure(name: str, alt: str, image: Image) -> Figure:
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


def _script() -> str:
    """The modules of the 3D view as one, since a single file can import nothing."""
    parts = [_file(name) for name in MODULES]
    lines = [line for part in parts for line in part.splitlines() if not line.startswith("import ")]
    return "\n".join(line.removeprefix("export ") for line in lines)


def _file(name: str) -> str:
    return resources.files("genmf_mi.report").joinpath(name).read_text(encoding="utf-8")

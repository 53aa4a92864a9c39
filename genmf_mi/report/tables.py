"""Metrics and settings as rows of text: nested dicts made flat, numbers made legible, comparisons put side by side."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from numbers import Number
from typing import TypeGuard

import numpy as np

DASH = "–"
"""What stands for a value that was not measured."""

STATES = ("before", "displacement", "unconstrained", "after")
STRESSES = (
    ("p99_9", "max (p99.9)", ("von_mises_mpa", "p99_9")),
    ("mean", "mean", ("von_mises_mpa", "mean")),
    ("surface_band_mean", "surface band, mean", ("surface_band", "mean")),
    ("surface_band_p99_9", "surface band, max", ("surface_band", "p99_9")),
    ("warpage", "warpage off the bed, mm", ("warpage", "flatness_mm")),
)
"""Measures of stress: key among the ratios of a verification, name for people, and path in the summary of a shape."""

_WORDS = {
    "ssim": "SSIM",
    "lpips_alex": "LPIPS (AlexNet)",
    "lpips_vgg": "LPIPS (VGG16)",
    "g_ssim": "SSIM of gradients",
    "g_lpips": "LPIPS of gradients",
    "inside": "inside the silhouette",
    "mask": "inside the silhouette",
    "outline_iou": "silhouette, intersection over union",
    "p95": "95th percentile",
    "grey_l1": "grey L1",
    "lpips": "LPIPS",
    "p99": "99th percentile",
    "max": "largest",
    "self_intersections_asset": "self-intersections in the file",
    "self_intersections_before": "self-intersections before refining",
    "self_intersections": "self-intersections",
    "new_self_intersections": "new self-intersections",
    "untangled": "self-intersections with the full relief",
    "vertices_held_back": "vertices whose relief was reduced",
    "samples_held_back": "samples whose relief was reduced",
    "bodies": "components",
    "bodies_before": "components before",
    "stray_bodies_dropped": "small components dropped",
    "open_edges_before": "boundary edges before",
    "crowded_edges_before": "non-manifold edges before",
    "ssim_mask": "SSIM, silhouette",
    "g_ssim_mask": "SSIM of gradients, silhouette",
    "lpips_mask_alex": "LPIPS (AlexNet), silhouette",
    "lpips_mask_vgg": "LPIPS (VGG16), silhouette",
    "grey_lpips": "grey LPIPS",
    "gradient": "gradient match",
    "gradient_sign": "gradient sign",
    "normal_flip": "flipped normals",
    "sdf_tv": "total variation of the SDF",
    "l_dev": "FlexiCubes L_dev",
    "flexi_weight_reg": "FlexiCubes weights",
    "stress": "predicted stress, L_stress",
    "stress_mean": "predicted stress, mean (1: before)",
    "stress_variance": "predicted stress, variance (1: before)",
    "stress_band": "predicted stress, surface band (1: before)",
    "stress_peak": "predicted stress, peak (1: before)",
    "relief_backed_off": "relief taken back, share of the surface",
    "nonfinite_gradients": "gradients that were not finite",
}
_TERMS = {"loss": "total loss", "ssim": "1 − SSIM", "gradient_ssim": "1 − SSIM of gradients"}
_UNITS = {
    "mm": "mm",
    "mm2": "mm²",
    "cm2": "cm²",
    "mm3": "mm³",
    "seconds": "s",
    "s": "s",
    "deg": "°",
    "mb": "MB",
    "gb": "GB",
}


@dataclass(frozen=True)
class Comparison:
    """A table with one row per metric and one column per state (before, displacement, after).

    group: where the metrics stand in the nested dict without the state, e.g. ``("unseen",)``.
    rows: name, cells by state, change from before to after in words.
    """

    group: tuple[str, ...]
    title: str
    states: list[str]
    rows: list[tuple[str, list[str], str]]


@dataclass(frozen=True)
class TextTable:
    """Titles of the columns, and rows of as many cells, the name of the row first."""

    columns: list[str]
    rows: list[list[str]]


def flatten(nested: object, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], object]]:
    """Leaves of nested dicts and lists with their paths; lists of plain values are leaves, dotted keys are split."""
    if isinstance(nested, dict):
        for key, value in nested.items():
            yield from flatten(value, path + tuple(str(key).split(".")))
    elif isinstance(nested, (list, tuple)) and any(isinstance(value, (dict, list, tuple)) for value in nested):
        for index, value in enumerate(nested):
            yield from flatten(value, (*path, str(index + 1)))
    else:
        yield path, nested


def label(path: tuple[str, ...] | str) -> str:
    """A path as people read it: ``("unseen", "lpips_alex")`` becomes "unseen · LPIPS (AlexNet)"."""
    path = (path,) if isinstance(path, str) else path
    return " · ".join(_WORDS.get(key) or _without_unit(key).replace("_", " ") for key in path)


def term(name: str) -> str:
    """A loss term as people read it: as :func:`label`, but what falls as the similarity rises is not called by it."""
    return _TERMS.get(name) or label(name)


def _without_unit(key: str) -> str:
    name, _, unit = key.rpartition("_")
    return name if name and unit in _UNITS else key


def text(value: object) -> str:
    """A value as people read and copy it; a dash for None and for what is not finite."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if value is None:
        return DASH
    if isinstance(value, (bool, np.bool_)):
        return "yes" if value else "no"
    if isinstance(value, (int, np.integer)):
        return str(int(value))
    if isinstance(value, (float, np.floating)):
        if not math.isfinite(value):
            return DASH
        return f"{value:.0f}" if 1e5 <= abs(value) < 1e12 else f"{value:.5g}"
    if isinstance(value, (list, tuple)):
        return ", ".join(text(entry) for entry in value) or DASH
    return str(value)


def with_unit(path: tuple[str, ...], value: object) -> str:
    """:func:`text` with the unit that the names of the path carry (``relief_mm``, ``volume_mm3``, ``seconds``)."""
    written = text(value)
    if written == DASH or not isinstance(value, Number) or isinstance(value, bool):
        return written
    for key in reversed(path):
        unit = _UNITS.get(key.rsplit("_", 1)[-1])
        if unit:
            return f"{written}\N{NO-BREAK SPACE}{unit}"
    return written


def rows(nested: dict) -> list[tuple[str, str]]:
    """Every leaf of a nested dict as name and text."""
    return [(label(path), with_unit(path, value)) for path, value in flatten(nested)]


def compare(metrics: dict) -> tuple[list[Comparison], list[tuple[str, str]]]:
    """Split metrics into side-by-side tables, one per group that has states, and the remaining rows."""
    groups: dict[tuple[str, ...], dict[str, dict[str, object]]] = {}
    rest = []
    for path, value in flatten(metrics):
        state = next((i for i, key in enumerate(path[:-1]) if key in STATES), None)
        if state is None:
            rest.append((label(path), with_unit(path, value)))
        else:
            group = path[:state] + path[state + 1 : -1]
            groups.setdefault(group, {}).setdefault(path[-1], {})[path[state]] = value
    return [_comparison(group, table) for group, table in groups.items()], rest


def stress(metrics: dict) -> TextTable | None:
    """Thermal stress of the shapes of a run next to their LPIPS; None if the run was not verified.

    Args:
        metrics: with the result of :func:`genmf_mi.stress.report.verification.verify` as ``stress``.
    """
    verification = metrics.get("stress") or {}
    if "ratio" not in verification:
        return None
    titles = {"before": "Before", "unconstrained": "Without stress stage", "after": "Refined"}
    shapes = [name for name in titles if name in verification["shapes"]]
    compared = "constrained" in verification["ratio"]
    rows = []
    for key, name, (group, quantity) in STRESSES:
        if not all(verification["shapes"][shape].get(group) for shape in shapes):
            continue  # no warpage: a part too thin for its mesh, or a run from before there was any
        row = [name]
        for shape in shapes:
            ratio = verification["ratio"].get(shape, {}).get(key)
            row.append(with_ratio(verification["shapes"][shape][group][quantity], ratio))
        if compared:
            remains = verification["remains"].get(key)
            row += [_times(verification["ratio"]["constrained"].get(key)), percent(remains)]
        rows.append(row)
    lpips = {shape: metrics.get(shape, {}).get("lpips_alex") for shape in shapes}
    row = [label("lpips_alex"), *(_cell("lpips_alex", lpips[shape]) for shape in shapes)]
    if compared:
        kept = kept_gain(lpips["before"], lpips["unconstrained"], lpips["after"])
        row += [
            _times(lpips["after"] / lpips["unconstrained"] if lpips["unconstrained"] else None),
            DASH if kept is None else f"{percent(kept)} kept",
        ]
    columns = ["", *(titles[shape] for shape in shapes)]
    return TextTable(columns + (["Refined / without", "Increase left"] if compared else []), [*rows, row])


def stands(metrics: dict) -> TextTable | None:
    """The ways to stand on the print bed that a run looked at, the best one first; None if it was told which."""
    found = metrics.get("stand", {}).get("candidates")
    if not found:
        return None
    columns = ["", "Tilt of the object", "LPIPS as printed", "Overhang", "Height", "Cost"]
    rows = []
    for each in found:
        tilt = math.degrees(math.acos(max(-1.0, min(1.0, each["up"][1]))))
        cost = "larger than the bed" if each["cost"] is None else f"{each['cost']:.2f}"
        seen = _cell("lpips", each["lpips"])
        height = f"{each['height_mm']:.0f} mm"
        rows.append([each["name"], f"{tilt:.0f}°", seen, percent(each["overhang_share"]), height, cost])
    return TextTable(columns, rows)


def kept_gain(before: float, unconstrained: float, after: float) -> float | None:
    """The share of the gain in LPIPS that the stress stage leaves; None where there was no gain."""
    return (before - after) / (before - unconstrained) if unconstrained < before else None


def with_ratio(value: float, ratio: float | None) -> str:
    """A stress in MPa, with its ratio to another where there is one."""
    return f"{value:.3f}" + (f" {_times(ratio)}" if ratio is not None else "")


def percent(share: float | None) -> str:
    """A share as a person reads it."""
    return DASH if share is None else f"{100 * share:.0f} %"


def _times(ratio: float | None) -> str:
    return DASH if ratio is None else f"×{ratio:.2f}"


def _comparison(group: tuple[str, ...], table: dict[str, dict[str, object]]) -> Comparison:
    states = [state for state in STATES if any(state in cells for cells in table.values())]
    rows = []
    for name, cells in table.items():
        written = [_cell(name, cells.get(state)) for state in states]
        rows.append((label(name), written, change(name, cells.get("before"), cells.get("after"))))
    titles = {
        (): "Standard views, full frame",
        ("unseen",): "Views and lights the optimiser never saw",
        ("paper_alignment",): "Standard views, mean and variance aligned as in the paper",
        ("unseen", "paper_alignment"): "Unseen views, aligned as in the paper",
    }
    return Comparison(group, titles.get(group, label(group).capitalize()), states, rows)


def _cell(name: str, value: object) -> str:
    """Similarities and distances get four decimals each, so that a column can be read down."""
    if _direction(name) and is_finite(value):
        return f"{value:.4f}"
    return with_unit((name,), value)


def change(name: str, before: object, after: object) -> str:
    """The change between two values in words, judged where the metric has a good direction."""
    if not (is_finite(before) and is_finite(after)):
        return DASH
    difference = after - before
    if abs(difference) < 5e-5:
        return "no change"
    amount = f"{difference:+.4f}".replace("-", "−")
    if before:
        amount += f" ({100 * difference / abs(before):+.0f} %)".replace("-", "−")
    direction = _direction(name)
    return f"{amount}, {'better' if direction * difference > 0 else 'worse'}" if direction else amount


def is_finite(value: object) -> TypeGuard[float]:
    """Whether ``value`` is a finite number (booleans are not numbers here)."""
    return isinstance(value, (int, float, np.number)) and not isinstance(value, bool) and math.isfinite(value)


def _direction(name: str) -> int:
    """1 where more is better, -1 where less is better, 0 where neither."""
    if "lpips" in name:
        return -1
    return 1 if "ssim" in name or name == "outline_iou" else 0

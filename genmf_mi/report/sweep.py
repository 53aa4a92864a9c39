"""The trade-off between appearance and stress, as a table and as a picture."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from genmf_mi.core.files import atomic
from genmf_mi.report.tables import TextTable, percent, with_ratio

CURVES = {"p99_9": "max (p99.9)", "mean": "mean", "surface_band_mean": "surface band, mean"}
"""The ratios that are tabled and drawn: the last is what relief changes most."""


def sweep_table(summary: dict[str, Any]) -> TextTable:
    """The contents of ``sweep.json`` for people.

    × is relative to the run without the stress stage; the increase is that of the surface band.
    """
    before = summary["before"]
    stresses = [with_ratio(before["stress"][key], None) for key in CURVES]
    rows = [["before", f"{before['lpips_alex']:.4f}", "", *stresses, ""]]
    for run in summary["runs"]:
        rows.append(
            [
                f"{run['stress_weight']:g}",
                f"{run['lpips_alex']:.4f}",
                percent(run["kept_gain"]),
                *(with_ratio(run["stress"][key], run["ratio"][key]) for key in CURVES),
                percent(run["remains"].get("surface_band_mean")),
            ]
        )
    return TextTable(["weight", "LPIPS", "gain\nkept", *CURVES.values(), "increase\nleft"], rows)


def write_sweep_picture(path: Path, summary: dict[str, Any]) -> None:
    """Stress relative to the run without the stress stage over LPIPS, a point per weight; dotted, the shape before.

    Raises:
        OutputError: the file cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 5), layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    runs = summary["runs"]
    lpips = [run["lpips_alex"] for run in runs]
    for key, title in CURVES.items():
        ratio = [run["ratio"][key] for run in runs]
        (line,) = axes.plot(lpips, ratio, marker="o", label=title)
        floor = summary["before"]["stress"][key] / runs[0]["stress"][key]
        axes.axhline(floor, color=line.get_color(), linestyle=":", linewidth=1)
    for x, run in zip(lpips, runs):
        top = max(run["ratio"][key] for key in CURVES)
        axes.annotate(
            f"{run['stress_weight']:g}", (x, top), (0, 7), textcoords="offset points", ha="center", fontsize=9
        )
    axes.set_title(f"{summary['asset']}: appearance and stress, by weight of the stress", loc="left", fontsize=10)
    axes.set_xlabel("LPIPS (lower is better)", fontsize=9)
    axes.set_ylabel("stress, 1: without the stress stage; dotted: the shape before", fontsize=9)
    axes.grid(alpha=0.3)
    axes.legend(frameon=False, fontsize=9)
    with atomic(path) as temporary:
        figure.savefig(temporary, dpi=110)

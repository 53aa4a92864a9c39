"""What a lower thermal stress costs in appearance: one refinement per weight, each judged by finite elements."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from math import isfinite
from pathlib import Path

from genmf_mi.core.config import RefineConfig
from genmf_mi.core.errors import ConfigError
from genmf_mi.core.files import atomic, write_text
from genmf_mi.pipeline.refinement import Listener, refine
from genmf_mi.pipeline.run_folder import CHECKPOINT, METRICS, Run
from genmf_mi.report.tables import STRESSES, TextTable, kept_gain, percent, with_ratio

SUMMARY, PICTURE = "sweep.json", "sweep.png"
CURVES = {"p99_9": "max (p99.9)", "mean": "mean", "surface_band_mean": "surface band, mean"}
"""The ratios that are tabled and drawn: the last is what relief changes most."""


def sweep(
    asset: str,
    weights: tuple[float, ...],
    config: RefineConfig,
    *,
    out: Path,
    force: bool = False,
    listener: Listener | None = None,
    begin: Callable[[float], None] = lambda weight: None,
    **options,
) -> dict:
    """Refine ``asset`` once per weight of the stress, and compare; finished runs in ``out`` are taken as they are.

    Args:
        weights: 0 stands for no stress stage and is added if it is not there.
        out: holds a folder for each run, and ``sweep.json`` and ``sweep.png`` after each.
        force: replace the runs in ``out``.
        begin: called with the weight before its run.
        options: more for :func:`genmf_mi.pipeline.refinement.refine`.

    Returns:
        The contents of ``sweep.json``: ``asset``; ``before``, scores and stress of the shape before; ``runs``, in order
        of their weights, each with ``stress_weight``, ``folder``, ``lpips_alex``, ``unseen`` (LPIPS on unseen views),
        ``kept_gain`` (share of the gain in LPIPS without the stress stage), ``stress`` in MPa, ``ratio`` over the run
        without the stress stage, and ``remains`` as by :func:`genmf_mi.stress.report.verification.judge`.

    Raises:
        ConfigError: a weight that is negative or not a number, a method without a stress stage, or a run in ``out`` of
            other settings. KeyboardInterrupt: the same call goes on from there. As :func:`genmf_mi.pipeline.refinement.refine`.
    """
    if not all(isfinite(weight) and weight >= 0 for weight in weights):
        raise ConfigError(
            f"weights of the stress cannot be negative: {', '.join(f'{weight:g}' for weight in weights)}."
        )
    if config.method != "relief":
        raise ConfigError("a sweep needs the stress stage of --method relief.")
    runs: dict[str, dict] = {}
    for weight in sorted({0.0, *weights}):
        begin(weight)
        name = f"w{weight:g}"
        # The part before is the same for all
        shapes = ("after",) if weight else ("before", "after")
        settings = replace(config, stress=weight > 0, stress_weight=weight)
        metrics = None if force else _finished(out / name, settings, shapes)
        if metrics is None:
            resume = not force and (out / name / CHECKPOINT).exists()
            metrics = refine(
                asset,
                settings,
                out=out / name,
                verify=shapes,
                force=not resume,
                resume=resume,
                listener=listener,
                **options,
            ).metrics
            if metrics["interrupted"]:
                raise KeyboardInterrupt
        runs[name] = {"stress_weight": weight, "metrics": metrics}
        found = summarise(runs)
        write_text(out / SUMMARY, json.dumps(found, indent=2) + "\n")
        write_picture(out / PICTURE, found)
    return found


def _finished(folder: Path, settings: RefineConfig, shapes: tuple[str, ...]) -> dict | None:
    """The metrics of a run that is complete, with ``shapes`` simulated."""
    if (folder / CHECKPOINT).exists() or not (folder / METRICS).exists():
        return None
    Run(folder).require(settings.to_dict())
    metrics = json.loads((folder / METRICS).read_text(encoding="utf-8"))
    return metrics if set(shapes) <= set(metrics.get("stress", {}).get("shapes", ())) else None


def summarise(runs: dict[str, dict]) -> dict:
    """See :func:`sweep`; ``runs`` by folder, that without the stress stage first, each with weight and metrics."""
    from genmf_mi.stress.report.comparison import ratios
    from genmf_mi.stress.report.verification import effect

    without = next(iter(runs.values()))["metrics"]
    before, unconstrained = (without["stress"]["shapes"][name] for name in ("before", "after"))
    rows = []
    for folder, run in runs.items():
        metrics = run["metrics"]
        stress = metrics["stress"]["shapes"]["after"]
        ratio, remains = effect(ratios(before, unconstrained), ratios(before, stress))
        lpips = [row["lpips_alex"] for row in (without["before"], without["after"], metrics["after"])]
        rows.append(
            {
                "stress_weight": run["stress_weight"],
                "folder": folder,
                "lpips_alex": lpips[-1],
                "unseen": metrics.get("unseen", {}).get("after", {}).get("lpips_alex"),
                "kept_gain": kept_gain(*lpips),
                "stress": _stresses(stress),
                "ratio": ratio,
                "remains": remains,
            }
        )
    scores = {"lpips_alex": without["before"]["lpips_alex"], "stress": _stresses(before)}
    return {"asset": without["asset"], "before": scores, "runs": rows}


def _stresses(summary: dict) -> dict[str, float]:
    return {name: summary[group][quantity] for name, _, (group, quantity) in STRESSES}


def table(found: dict) -> TextTable:
    """The contents of ``sweep.json`` as a person reads them.

    × is relative to the run without the stress stage; the increase is that of the surface band.
    """
    before = found["before"]
    stresses = [with_ratio(before["stress"][key], None) for key in CURVES]
    rows = [["before", f"{before['lpips_alex']:.4f}", "", *stresses, ""]]
    for run in found["runs"]:
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


def write_picture(path: Path, found: dict) -> None:
    """The trade-off: stress relative to the run without the stress stage over LPIPS, a point per weight, and dotted
    where the shape before lies. Raises :class:`OutputError`."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 5), layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    runs = found["runs"]
    lpips = [run["lpips_alex"] for run in runs]
    for key, title in CURVES.items():
        ratio = [run["ratio"][key] for run in runs]
        (line,) = axes.plot(lpips, ratio, marker="o", label=title)
        floor = found["before"]["stress"][key] / runs[0]["stress"][key]
        axes.axhline(floor, color=line.get_color(), linestyle=":", linewidth=1)
    for x, run in zip(lpips, runs):
        top = max(run["ratio"][key] for key in CURVES)
        axes.annotate(
            f"{run['stress_weight']:g}", (x, top), (0, 7), textcoords="offset points", ha="center", fontsize=9
        )
    axes.set_title(f"{found['asset']}: appearance and stress, by weight of the stress", loc="left", fontsize=10)
    axes.set_xlabel("LPIPS (lower is better)", fontsize=9)
    axes.set_ylabel("stress, 1: without the stress stage; dotted: the shape before", fontsize=9)
    axes.grid(alpha=0.3)
    axes.legend(frameon=False, fontsize=9)
    with atomic(path) as temporary:
        figure.savefig(temporary, dpi=110)

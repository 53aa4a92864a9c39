"""What a lower thermal stress costs in appearance: one refinement per weight, each verified by finite elements."""

from __future__ import annotations

import json
from dataclasses import replace
from math import isfinite
from pathlib import Path
from typing import Any

from genmf_mi.core.config import RefineConfig
from genmf_mi.core.errors import ConfigError
from genmf_mi.core.files import write_text
from genmf_mi.core.progress import PrefixedProgress, Progress
from genmf_mi.pipeline import regions
from genmf_mi.pipeline.refinement import refine
from genmf_mi.pipeline.run_folder import RunFolder
from genmf_mi.report.sweep import write_sweep_picture
from genmf_mi.report.tables import STRESSES, kept_gain
from genmf_mi.stress.report.comparison import ratios
from genmf_mi.stress.report.verification import effect

SUMMARY, PICTURE = "sweep.json", "sweep.png"


def sweep(
    asset: str,
    weights: tuple[float, ...],
    config: RefineConfig,
    *,
    out: Path,
    force: bool = False,
    progress: Progress | None = None,
    **options: Any,
) -> dict[str, Any]:
    """Refine ``asset`` once per weight of the stress, and compare; finished runs in ``out`` are taken as they are.

    A KeyboardInterrupt ends the sweep; the same call continues it.

    Args:
        weights: 0 stands for no stress stage and is always included.
        out: holds a folder for each run, and ``sweep.json`` and ``sweep.png`` after each.
        force: replace the runs in ``out``.
        options: more for :func:`genmf_mi.refine`.

    Returns:
        The contents of ``sweep.json``: ``asset``; ``before``, scores and stress of the shape before; ``runs``, in order
        of their weights, each with ``stress_weight``, ``folder``, ``lpips_alex``, ``unseen`` (LPIPS on unseen views),
        ``kept_gain`` (share of the gain in LPIPS without the stress stage), ``stress`` in MPa, ``ratio`` over the run
        without the stress stage, and ``remains`` as by :func:`genmf_mi.stress.report.verification.verify`.

    Raises:
        ConfigError: a weight that is negative or not a number, a method without a stress stage, or a run in ``out`` of
            other settings. As :func:`genmf_mi.refine`.
    """
    if not all(isfinite(weight) and weight >= 0 for weight in weights):
        raise ConfigError(
            f"weights of the stress cannot be negative: {', '.join(f'{weight:g}' for weight in weights)}."
        )
    if config.method != "relief":
        raise ConfigError("a sweep needs the stress stage of --method relief.")
    runs: dict[str, dict[str, Any]] = {}
    summary: dict[str, Any] = {}
    for weight in sorted({0.0, *weights}):
        name = f"w{weight:g}"
        # The part before is the same for all
        shapes = ("after",) if weight else ("before", "after")
        settings = replace(config, stress=weight > 0, stress_weight=weight)
        folder = RunFolder(out / name)
        metrics = None if force else _finished(folder, settings, shapes)
        if metrics is None:
            resume = not force and folder.interrupted
            metrics = refine(
                asset,
                settings,
                out=folder.path,
                verify=shapes,
                force=not resume,
                resume=resume,
                progress=PrefixedProgress(progress or Progress(), f"stress weight {weight:g}: "),
                **options,
            ).metrics
            if metrics["interrupted"]:
                raise KeyboardInterrupt
        runs[name] = {"stress_weight": weight, "metrics": metrics}
        summary = summarise(runs)
        write_text(out / SUMMARY, json.dumps(summary, indent=2) + "\n")
        write_sweep_picture(out / PICTURE, summary)
    return summary


def _finished(folder: RunFolder, settings: RefineConfig, shapes: tuple[str, ...]) -> dict[str, Any] | None:
    """The metrics of a run that is complete, with ``shapes`` simulated."""
    metrics = folder.metrics()
    if metrics is None:
        return None
    folder.require({**settings.to_dict(), "inputs": regions.fingerprints(regions.copies(settings))})
    return metrics if set(shapes) <= set(metrics.get("stress", {}).get("shapes", ())) else None


def summarise(runs: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """See :func:`sweep`; ``runs`` by folder, that without the stress stage first, each with weight and metrics."""
    without = next(iter(runs.values()))["metrics"]
    before, unconstrained = (without["stress"]["shapes"][name] for name in ("before", "after"))
    rows: list[dict[str, Any]] = []
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


def _stresses(summary: dict[str, Any]) -> dict[str, float]:
    return {name: summary[group][quantity] for name, _, (group, quantity) in STRESSES if summary.get(group)}

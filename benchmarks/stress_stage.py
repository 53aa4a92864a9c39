"""The stress stage on real assets in the default preset, verified by finite elements.

Each asset is refined with and without the stage in one run (``refine --verify``), in a process of its own.
"""

from __future__ import annotations

from shlex import split

import numpy as np

from benchmarks import record
from benchmarks.inputs import FIVE_ASSETS, Inputs
from benchmarks.runs import refined
from genmf_mi.report.tables import kept_gain

MEASURES = ("p99_9", "mean", "surface_band_mean", "surface_layer_mean")


def main(inputs: Inputs, *, arguments: str = "", name: str = "stress_stage") -> None:
    """Refine, verify, tabulate.

    Args:
        inputs: What all benchmarks have in common; this one reads --assets.
        arguments: More for `genmf-mi refine`, in one string.
        name: Of the file of results and of the folder of the runs.
    """
    rows = []
    for path in inputs.asset_files(FIVE_ASSETS):
        metrics = refined(path, inputs.out / name / path.stem, "--verify", *split(arguments))
        rows.append(row(path.stem, metrics) if metrics else {"asset": path.stem, "failed": True})
        print(rows[-1], flush=True)
    record.write(name, {"assets": rows, "summary": summary([row for row in rows if "failed" not in row])})


def row(asset: str, metrics: dict) -> dict:
    """The figures of one run, from its ``metrics.json``; ``ratio`` and ``remains`` are those of
    :func:`genmf_mi.stress.report.verification.verify`."""

    def rounded(figures: dict) -> dict:
        return {key: None if figures.get(key) is None else round(figures[key], 4) for key in MEASURES}

    verification, lpips = metrics["stress"], {}
    if left_out := metrics.get("stress_stage_left_out"):  # then the result is what it is without the stage
        after = verification["ratio"]["after"]
        verification["ratio"] |= {"unconstrained": after, "constrained": dict.fromkeys(after, 1.0)}
        verification["remains"] = dict.fromkeys(after, 1.0)
    for group, block in (("", metrics), ("unseen", metrics["unseen"])):
        shapes = ("before", "after" if left_out else "unconstrained", "after")
        lpips[group or "standard"] = [round(block[shape]["lpips_alex"], 4) for shape in shapes]
    kept = {views: kept_gain(*figures) for views, figures in lpips.items()}
    return {
        "asset": asset,
        **({"left_out": left_out} if left_out else {}),
        "lpips": lpips,
        "kept_gain": {views: None if share is None else round(share, 3) for views, share in kept.items()},
        "ratio": {shape: rounded(figures) for shape, figures in verification["ratio"].items()},
        "remains": rounded(verification["remains"]),
        "relief_mm": {key: round(value, 3) for key, value in metrics["relief_mm"].items()},
        "seconds": {key: round(value, 1) for key, value in metrics["seconds"].items()},
        "peak_memory_gb": round(metrics["peak_memory_gb"], 2),
    }


def summary(rows: list[dict]) -> dict:
    """Means over the assets."""
    if not rows:
        return {}

    def mean(figures: list[float]) -> float:
        return round(float(np.mean(figures)), 4)

    return {
        "constrained": {key: mean([r["ratio"]["constrained"][key] for r in rows]) for key in MEASURES},
        "kept_gain": {views: mean([r["kept_gain"][views] for r in rows]) for views in ("standard", "unseen")},
    }

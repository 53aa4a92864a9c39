"""The stress stage on real assets, judged by finite elements, in the default preset.

    GENMF_TEST_ASSETS=DIR python -m benchmarks.stress_stage [NAMES ...] [--out DIR] [--arguments="..."]

Each asset is refined with and without the stage in one run (``refine --verify``), in a process of its own; runs that
``out`` holds are taken as they are.
"""

from __future__ import annotations

import os
from pathlib import Path
from shlex import split

import numpy as np
import tyro
from tyro.conf import Positional

from benchmarks import record
from benchmarks.assets import refined
from genmf_mi.report.tables import kept_gain

FIVE = ("hunyuan_bus", "sf3d_raccoon", "sf3d_garlic", "trellis_volcano", "spot")
MEASURES = ("p99_9", "mean", "surface_band_mean", "surface_layer_mean")


def main(
    names: Positional[tuple[str, ...]] = FIVE,
    /,
    out: Path = Path("runs/stress-stage"),
    arguments: str = "",
    name: str = "stress_stage",
) -> None:
    """Refine, verify, tabulate.

    Args:
        names: Of assets in the folder ``GENMF_TEST_ASSETS``.
        out: Folder of the runs.
        arguments: More for `genmf-mi refine`.
        name: Of the file of results.
    """
    folder, rows = Path(os.environ["GENMF_TEST_ASSETS"]), []
    for asset in names:
        metrics = refined(folder / f"{asset}.glb", out / asset, "--verify", *split(arguments))
        rows.append(row(asset, metrics) if metrics else {"asset": asset, "failed": True})
        print(rows[-1], flush=True)
    record.write(name, {"assets": rows, "summary": summary([row for row in rows if "failed" not in row])})


def row(asset: str, metrics: dict) -> dict:
    """What a table needs of one run; ``ratio`` and ``remains`` as by :func:`genmf_mi.stress.report.verification.judge`."""

    def rounded(figures: dict) -> dict:
        return {key: None if figures.get(key) is None else round(figures[key], 4) for key in MEASURES}

    verdict, lpips = metrics["stress"], {}
    if left_out := metrics.get("stress_stage_left_out"):  # then the result is what it is without the stage
        after = verdict["ratio"]["after"]
        verdict["ratio"] |= {"unconstrained": after, "constrained": dict.fromkeys(after, 1.0)}
        verdict["remains"] = dict.fromkeys(after, 1.0)
    for group, block in (("", metrics), ("unseen", metrics["unseen"])):
        shapes = ("before", "after" if left_out else "unconstrained", "after")
        lpips[group or "standard"] = [round(block[shape]["lpips_alex"], 4) for shape in shapes]
    kept = {views: kept_gain(*figures) for views, figures in lpips.items()}
    return {
        "asset": asset,
        **({"left_out": left_out} if left_out else {}),
        "lpips": lpips,
        "kept_gain": {views: None if share is None else round(share, 3) for views, share in kept.items()},
        "ratio": {shape: rounded(figures) for shape, figures in verdict["ratio"].items()},
        "remains": rounded(verdict["remains"]),
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


if __name__ == "__main__":
    tyro.cli(main)

"""Seconds, memory and scores of the default preset with `--no-stress` on real assets, each in a process of its own.

``GENMF_TEST_ASSETS`` names their folder; ``GENMF_BENCH_ASSETS`` may name others than the eight below, separated by
spaces, and ``GENMF_BENCH_OUT`` a folder to keep the results in. Assets that are done there are not done again.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np

from benchmarks import record

EIGHT = (
    "hunyuan_bus",
    "sf3d_raccoon",
    "sf3d_garlic",
    "sf3d_schoolbus",
    "trellis_volcano",
    "instantmesh_chair",
    "spot",
    "teacup",
)
SCORES = ("ssim", "lpips_alex", "lpips_vgg", "g_ssim", "g_lpips")


def main() -> None:
    folder = Path(os.environ["GENMF_TEST_ASSETS"])
    names = os.environ.get("GENMF_BENCH_ASSETS", " ".join(EIGHT)).split()
    out = Path(os.environ.get("GENMF_BENCH_OUT", "runs/bench"))
    rows = []
    for name in names:
        metrics = refined(folder / f"{name}.glb", out / name, "--no-stress")
        rows.append(row(name, metrics) if metrics else {"asset": name, "failed": True})
        print(rows[-1], flush=True)
    record.write("assets", {"assets": rows, "summary": summary([r for r in rows if "failed" not in r])})


def refined(asset: Path, out: Path, *arguments: str) -> dict | None:
    """The metrics of a run in a process of its own, or of the one that ``out`` holds; None if it failed."""
    done = out / "metrics.json"
    if not done.exists():
        command = ["refine", str(asset), "--out", str(out), "--force", "--quiet", *arguments]
        subprocess.run([sys.executable, "-m", "genmf_mi", *command], check=False)
    return json.loads(done.read_text(encoding="utf-8")) if done.exists() else None


def row(name: str, metrics: dict) -> dict:
    """The figures of one run that a table needs."""

    def scores(block: dict) -> dict:
        return {shape: {k: round(block[shape][k], 4) for k in SCORES} for shape in ("before", "displacement", "after")}

    return {
        "asset": name,
        **scores(metrics),
        "unseen": scores(metrics["unseen"]),
        "relief_mm": {k: round(v, 3) for k, v in metrics["relief_mm"].items()},
        "solid": {
            k: metrics["solid"][k] for k in ("watertight", "bodies", "self_intersections_before", "self_intersections")
        },
        "iterations": metrics["iterations"],
        "seconds": {k: round(v, 1) for k, v in metrics["seconds"].items()},
        "peak_memory_gb": round(metrics["peak_memory_gb"], 2),
    }


def summary(rows: list[dict]) -> dict:
    """What holds over all assets."""
    if not rows:
        return {}

    def fall(r: dict) -> float:
        return 1 - r["after"]["lpips_alex"] / r["before"]["lpips_alex"]

    def gain(r: dict, key: str) -> float:
        return r["after"][key] - r["before"][key]

    def beats(r: dict) -> bool:
        return (
            r["after"]["ssim"] > r["displacement"]["ssim"]
            and r["after"]["lpips_alex"] < r["displacement"]["lpips_alex"]
        )

    def loses(r: dict) -> bool:
        return (
            r["after"]["ssim"] < r["displacement"]["ssim"]
            and r["after"]["lpips_alex"] > r["displacement"]["lpips_alex"]
        )

    def kept(r: dict) -> float:
        return (1 - r["unseen"]["after"]["lpips_alex"] / r["unseen"]["before"]["lpips_alex"]) / fall(r)

    return {
        "mean_lpips_fall": round(float(np.mean([fall(r) for r in rows])), 3),
        "mean_ssim_gain": round(float(np.mean([gain(r, "ssim") for r in rows])), 4),
        "mean_g_ssim_gain": round(float(np.mean([gain(r, "g_ssim") for r in rows])), 4),
        "worst_ssim_gain": round(min(gain(r, "ssim") for r in rows), 4),
        "worst_g_ssim_gain": round(min(gain(r, "g_ssim") for r in rows), 4),
        "beat_displacement_in_both": sum(map(beats, rows)),
        "worse_than_displacement_in_both": sum(map(loses, rows)),
        "share_of_lpips_gain_on_unseen": {
            "mean": round(float(np.mean([kept(r) for r in rows])), 3),
            "worst": round(min(kept(r) for r in rows), 3),
        },
        "median_seconds": float(np.median([r["seconds"]["total"] for r in rows])),
        "largest_peak_memory_gb": max(r["peak_memory_gb"] for r in rows),
    }

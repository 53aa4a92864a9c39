"""Scores, seconds and memory of real assets in the default preset with ``--no-stress``."""

from __future__ import annotations

import numpy as np

from benchmarks import record
from benchmarks.inputs import EIGHT_ASSETS, Inputs
from benchmarks.runs import refined

SCORES = ("ssim", "lpips_alex", "lpips_vgg", "g_ssim", "g_lpips")
SHAPES = ("before", "displacement", "after")


def main(inputs: Inputs, *, score_vgg: bool = False) -> None:
    """Refine the eight assets of the README, each in a process of its own, and tabulate.

    Args:
        inputs: What all benchmarks have in common; this one reads --assets.
        score_vgg: Score with VGG16 LPIPS too, which adds one or two minutes for each asset.
    """
    rows = []
    for path in inputs.asset_files(EIGHT_ASSETS):
        metrics = refined(
            path, inputs.out / "assets" / path.stem, "--no-stress", *(["--score-vgg"] if score_vgg else [])
        )
        rows.append(row(path.stem, metrics) if metrics else {"asset": path.stem, "failed": True})
        print(rows[-1], flush=True)
    record.write("assets", {"assets": rows, "summary": summary([r for r in rows if "failed" not in r])})


def row(name: str, metrics: dict) -> dict:
    """The figures of one run, from its ``metrics.json``."""

    def scores(block: dict) -> dict:
        return {
            shape: {k: round(block[shape][k], 4) for k in SCORES if block[shape][k] is not None} for shape in SHAPES
        }

    return {
        "asset": name,
        **scores(metrics),
        "unseen": scores(metrics["unseen"]),
        "paper_alignment": {
            **scores(metrics["paper_alignment"]),
            "unseen": scores(metrics["unseen"]["paper_alignment"]),
        },
        "outline_iou": {shape: round(metrics[shape]["outline_iou"], 4) for shape in SHAPES},
        "plain_distortion_mm": {k: round(v, 3) for k, v in metrics["plain_distortion_mm"].items()},
        "relief_mm": {k: round(v, 3) for k, v in metrics["relief_mm"].items()},
        "solid": {
            k: metrics["solid"][k] for k in ("watertight", "bodies", "self_intersections_before", "self_intersections")
        },
        "iterations": metrics["iterations"],
        "seconds": {k: round(v, 1) for k, v in metrics["seconds"].items()},
        "peak_memory_gb": round(metrics["peak_memory_gb"], 2),
    }


def summary(rows: list[dict]) -> dict:
    """Means and extremes over the assets."""
    if not rows:
        return {}

    def fall(r: dict, key: str = "lpips_alex", shape: str = "after") -> float:
        return 1 - r[shape][key] / r["before"][key]

    def mean(values) -> float:
        return round(float(np.mean(list(values))), 3)

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

    def unseen_share(r: dict) -> float:
        return (1 - r["unseen"]["after"]["lpips_alex"] / r["unseen"]["before"]["lpips_alex"]) / fall(r)

    return {
        "mean_lpips_fall": mean(map(fall, rows)),
        "mean_lpips_fall_of_displacement": mean(fall(r, shape="displacement") for r in rows),
        **(
            {"mean_lpips_vgg_fall": mean(fall(r, "lpips_vgg") for r in rows)} if "lpips_vgg" in rows[0]["after"] else {}
        ),
        "mean_lpips_fall_as_the_paper_aligns": mean(fall(r["paper_alignment"]) for r in rows),
        "largest_plain_p95_mm": max(r["plain_distortion_mm"]["p95"] for r in rows),
        "smallest_outline_iou": min(r["outline_iou"]["after"] for r in rows),
        "mean_ssim_gain": round(float(np.mean([gain(r, "ssim") for r in rows])), 4),
        "mean_g_ssim_gain": round(float(np.mean([gain(r, "g_ssim") for r in rows])), 4),
        "worst_ssim_gain": round(min(gain(r, "ssim") for r in rows), 4),
        "worst_g_ssim_gain": round(min(gain(r, "g_ssim") for r in rows), 4),
        "beat_displacement_in_both": sum(map(beats, rows)),
        "worse_than_displacement_in_both": sum(map(loses, rows)),
        "share_of_lpips_gain_on_unseen": {
            "mean": round(float(np.mean([unseen_share(r) for r in rows])), 3),
            "worst": round(min(unseen_share(r) for r in rows), 3),
        },
        "median_seconds": float(np.median([r["seconds"]["total"] for r in rows])),
        "largest_peak_memory_gb": max(r["peak_memory_gb"] for r in rows),
    }

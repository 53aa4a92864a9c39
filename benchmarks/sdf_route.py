"""Refinement of the field beside refinement of the mesh, default settings without the stress stage, real assets.

Each asset is converted to Φ on 129³ samples, written to a file, and refined from that. The figures of the mesh are
those of ``results/assets.json``, which :mod:`benchmarks.assets` makes.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from benchmarks import record
from benchmarks.inputs import EIGHT_ASSETS, Inputs
from benchmarks.runs import refined

SCORES = ("lpips_alex", "ssim", "g_ssim")
SAMPLES = 129


def main(inputs: Inputs) -> None:
    """Convert and refine the eight assets of the README, each in a process of its own, and tabulate.

    Args:
        inputs: What all benchmarks have in common; this one reads --assets.
    """
    mesh_rows = json.loads((record.FOLDER / "assets.json").read_text(encoding="utf-8"))["results"]["assets"]
    on_mesh = {row["asset"]: row for row in mesh_rows if "failed" not in row}
    rows = []
    for path in inputs.asset_files(EIGHT_ASSETS):
        folder = inputs.out / "sdf_route" / path.stem
        options = ("--textured", path, "--no-stress", "--no-score-vgg")
        metrics = refined(field_of(path, folder.with_suffix(".npz")), folder, *options)
        row = {"asset": path.stem, "failed": True} if metrics is None else {"asset": path.stem, "sdf": figures(metrics)}
        if path.stem in on_mesh and metrics is not None:
            row["mesh"] = figures(on_mesh[path.stem])
        rows.append(row)
        print(rows[-1], flush=True)
    done = [row for row in rows if "failed" not in row]
    record.write("sdf_route", {"samples_per_axis": SAMPLES, "assets": rows, "summary": summary(done)})


def field_of(asset: Path, path: Path) -> Path:
    """The file ``path`` with Φ of ``asset``; it is written if it does not exist yet."""
    from genmf_mi.assets.asset import load
    from genmf_mi.assets.generators import files
    from genmf_mi.assets.generators.from_mesh import sdf_from_mesh

    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        files.save(sdf_from_mesh(load(asset), SAMPLES), path)
    return path


def figures(metrics: dict) -> dict:
    """What the two routes are compared by."""

    def scores(block: dict) -> dict:
        return {key: [round(block[shape][key], 4) for shape in ("before", "displacement", "after")] for key in SCORES}

    solid = metrics["solid"]
    return {
        **scores(metrics),
        "unseen": scores(metrics["unseen"]),
        "relief_mm": {key: round(value, 3) for key, value in metrics["relief_mm"].items()},
        "closed_manifold": solid["watertight"],
        "bodies": solid["bodies"],
        "self_intersections": [solid["self_intersections_before"], solid["self_intersections"]],
        **{key: solid[key] for key in ("faces", "untangled", "lost_fraction") if key in solid},
        "iterations": metrics["iterations"],
        "seconds": {key: round(metrics["seconds"][key], 1) for key in ("total", "optimise")},
        "peak_memory_gb": round(metrics["peak_memory_gb"], 2),
    }


def summary(rows: list[dict]) -> dict:
    """Means over the assets, by route."""

    def over(rows: list[dict]) -> dict:
        fall = [1 - row["lpips_alex"][2] / row["lpips_alex"][0] for row in rows]
        unseen = [1 - row["unseen"]["lpips_alex"][2] / row["unseen"]["lpips_alex"][0] for row in rows]
        return {
            "assets": len(rows),
            "mean_lpips_fall": round(float(np.mean(fall)), 3),
            "mean_lpips_fall_unseen": round(float(np.mean(unseen)), 3),
            "mean_ssim_gain": round(float(np.mean([row["ssim"][2] - row["ssim"][0] for row in rows])), 4),
            "mean_g_ssim_gain": round(float(np.mean([row["g_ssim"][2] - row["g_ssim"][0] for row in rows])), 4),
            "closed_manifolds": sum(row["closed_manifold"] for row in rows),
            "with_self_intersections": sum(row["self_intersections"][1] > 0 for row in rows),
            "median_seconds": float(np.median([row["seconds"]["total"] for row in rows])),
            "largest_peak_memory_gb": max(row["peak_memory_gb"] for row in rows),
        }

    sides = {side: [row[side] for row in rows if side in row] for side in ("sdf", "mesh")}
    return {side: over(chosen) for side, chosen in sides.items() if chosen}

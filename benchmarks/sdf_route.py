"""The mesh route against the SDF route, default settings without the stress stage, on real assets.

    python -m benchmarks.sdf_route ASSETS_DIR [NAME ...] [--out DIR]

Each asset is converted to Φ on 129³ samples, written to a file, and refined from that by the command line in a process
of its own. What is done in DIR (``runs/sdf_route``) is not done again. The mesh route's figures are those of
``results/assets.json``, which :mod:`benchmarks.assets` makes.
"""

from __future__ import annotations

import json
import subprocess
import sys
from argparse import ArgumentParser
from pathlib import Path

import numpy as np

from benchmarks import record
from benchmarks.assets import EIGHT

SCORES = ("lpips_alex", "ssim", "g_ssim")
SAMPLES = 129


def main() -> None:
    parser = ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("assets", type=Path, help="folder of the assets, NAME.glb each")
    parser.add_argument("names", nargs="*", default=EIGHT, help="which of them; the usual eight if not given")
    parser.add_argument("--out", type=Path, default=Path("runs/sdf_route"))
    chosen = parser.parse_args()
    mesh = json.loads((record.FOLDER / "assets.json").read_text(encoding="utf-8"))["results"]["assets"]
    on_mesh = {entry["asset"]: entry for entry in mesh if "failed" not in entry}
    rows = []
    for name in chosen.names:
        metrics = refined(chosen.assets / f"{name}.glb", chosen.out / name)
        row = {"asset": name, "failed": True} if metrics is None else {"asset": name, "sdf": figures(metrics)}
        if name in on_mesh and metrics is not None:
            row["mesh"] = figures(on_mesh[name])
        rows.append(row)
        print(rows[-1], flush=True)
    done = [row for row in rows if "failed" not in row]
    record.write("sdf_route", {"samples_per_axis": SAMPLES, "assets": rows, "summary": summary(done)})


def refined(path: Path, folder: Path) -> dict | None:
    """``metrics.json`` of the SDF route, made if it is not there; None if the refinement failed."""
    from genmf_mi.assets.asset import load
    from genmf_mi.assets.generators import files
    from genmf_mi.assets.generators.from_mesh import sdf_from_mesh

    done, field = folder / "metrics.json", folder.with_suffix(".npz")
    if not done.exists():
        if not field.exists():
            field.parent.mkdir(parents=True, exist_ok=True)
            files.save(sdf_from_mesh(load(path), SAMPLES), field)
        going_on = "--resume" if (folder / "checkpoint.npz").exists() else "--force"
        command = [
            sys.executable,
            "-m",
            "genmf_mi",
            "refine",
            field,
            "--textured",
            path,
            "--out",
            folder,
            "--no-stress",
        ]
        subprocess.run([*map(str, command), "--no-score-vgg", "--quiet", going_on], check=False)
    return json.loads(done.read_text(encoding="utf-8")) if done.exists() else None


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
    return {side: over(found) for side, found in sides.items() if found}


if __name__ == "__main__":
    main()

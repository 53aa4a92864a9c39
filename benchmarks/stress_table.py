"""Mean, p99.9, nodes and seconds of many shapes; every one is simulated or refused by name.

    python benchmarks/stress_table.py FOLDER_OR_FILE ... [--out benchmarks/results/stress_table.json]

Shapes already in the output are not run again.
"""

from __future__ import annotations

import json
import platform
import time
from pathlib import Path

import tyro
from tyro.conf import Positional

from genmf_mi.core.errors import GenmfError
from genmf_mi.core.files import write_text
from genmf_mi.stress.data.dataset import MESHES
from genmf_mi.stress.fem import simulation as fem
from genmf_mi.stress.fem import surface
from genmf_mi.stress.fem.statistics import summary


def row(path: Path, settings: fem.Settings) -> dict:
    started, cpu = time.perf_counter(), time.process_time()
    try:
        result = fem.simulate(*surface.load(path), settings)
    except GenmfError as error:
        return {"refused": str(error)}
    numbers = summary(result)
    mesh = numbers["mesh"]
    figures = {
        **numbers["von_mises_mpa"],
        "surface_band": numbers["surface_band"]["mean"],
        "displacement_max_mm": numbers["displacement_max_mm"],
        **{name: mesh[name] for name in ("quality_min", "dropped_fraction", "thin_fraction")},
    }
    return {
        **{name: round(value, 4) for name, value in figures.items()},
        "nodes": mesh["nodes"],
        "seconds_cpu": round(time.process_time() - cpu, 1),
        "seconds_wall": round(time.perf_counter() - started, 1),
    }


def main(
    paths: Positional[list[Path]], /, out: Path = Path("benchmarks/results/stress_table.json"), edge_mm: float = 1.6
) -> None:
    """Simulate mesh files, or all mesh files of folders, and write a table."""
    files = sorted(f for p in paths for f in (p.iterdir() if p.is_dir() else [p]) if f.suffix.lower() in MESHES)
    table = (
        json.loads(out.read_text(encoding="utf-8"))
        if out.exists()
        else {"edge_mm": edge_mm, "machine": platform.machine(), "shapes": {}}
    )
    for path in files:
        if path.stem not in table["shapes"]:
            table["shapes"][path.stem] = row(path, fem.Settings(edge_mm=edge_mm))
            write_text(out, json.dumps(table, indent=1) + "\n")
        print(path.stem, table["shapes"][path.stem], flush=True)


if __name__ == "__main__":
    tyro.cli(main)

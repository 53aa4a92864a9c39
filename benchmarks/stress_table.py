"""Mean, p99.9, nodes and seconds of many shapes; every one is simulated or refused by name."""

from __future__ import annotations

import json
import platform
import time
from dataclasses import replace
from pathlib import Path

from benchmarks import record
from benchmarks.inputs import EIGHT_ASSETS, Inputs
from genmf_mi.core.errors import GenmfError
from genmf_mi.core.files import write_text
from genmf_mi.core.timer import Timer
from genmf_mi.stress.fem import simulation as fem
from genmf_mi.stress.fem import surface
from genmf_mi.stress.fem.statistics import summary


def main(inputs: Inputs, *, edge_mm: float = 1.6, name: str = "stress_table") -> None:
    """Simulate the eight assets of the README and all meshes of a folder; what the table has is not repeated.

    Args:
        inputs: What all benchmarks have in common; this one reads --assets and --meshes.
        edge_mm: Side of the lattice that the tetrahedra come from.
        name: Of the file of results.
    """
    path = record.FOLDER / f"{name}.json"
    table = {"edge_mm": edge_mm, "machine": platform.machine(), "shapes": {}}
    if path.exists():
        table = json.loads(path.read_text(encoding="utf-8"))
    every = replace(inputs, names=())
    for file in [*every.asset_files(EIGHT_ASSETS), *every.mesh_files()]:
        if inputs.names and file.stem not in inputs.names:
            continue
        if file.stem not in table["shapes"]:
            table["shapes"][file.stem] = row(file, fem.Settings(edge_mm=edge_mm))
            write_text(path, json.dumps(table, indent=1) + "\n")
        print(file.stem, table["shapes"][file.stem], flush=True)


def row(path: Path, settings: fem.Settings) -> dict:
    """The figures of one shape, MPa, mm and seconds, or why it was refused."""
    timer, cpu_start = Timer(), time.process_time()
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
        "seconds_cpu": round(time.process_time() - cpu_start, 1),
        "seconds_wall": round(timer.total, 1),
    }

"""CalculiX (Debian: calculix-ccx) on the same mesh and conditions: temperature, displacement and von Mises.

The soft clamp becomes grounded springs (SPRING1), one property per held node and direction.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks import verification
from genmf_mi.sdf.distance import signed_distance
from genmf_mi.stress.fem import simulation as fem
from genmf_mi.stress.fem import surface, tet_mesh, tetrahedra
from genmf_mi.stress.fem.elasticity import soft_clamp, von_mises
from genmf_mi.stress.fem.materials import material
from genmf_mi.stress.fem.protocol import Protocol

_FACES = {"1": [0, 1, 2], "2": [0, 1, 3], "3": [1, 2, 3], "4": [0, 2, 3]}
"""Corners of the faces of C3D4 in CalculiX's numbering."""


PROTOCOL = Protocol(step_s=300.0)
"""Both take the same four steps; CalculiX factors its matrices anew in each."""


def deck(field: fem.Field, stuff, protocol: Protocol) -> str:
    """The input file; units t, mm, s, K (so mW for power)."""
    mesh, elements = field.mesh, field.elements
    n = len(mesh.points)
    key = lambda f: np.sort(f, axis=1) @ np.array([n * n, n, 1])  # noqa: E731
    outer = np.unique(key(mesh.boundary()))
    spring = soft_clamp(mesh.points[:, 2], elements.nodal_volume(), stuff.youngs_modulus_mpa, protocol.clamp_fraction)
    lines = ["*NODE,NSET=NALL"]
    lines += [f"{i + 1},{x:.12g},{y:.12g},{z:.12g}" for i, (x, y, z) in enumerate(mesh.points)]
    lines += ["*ELEMENT,TYPE=C3D4,ELSET=EALL"]
    lines += [f"{i + 1},{','.join(str(c + 1) for c in cell)}" for i, cell in enumerate(mesh.cells)]
    number = len(mesh.cells)
    for node in np.flatnonzero(spring > 0):
        for direction in (1, 2, 3):
            number += 1
            name = f"S{number}"
            lines += [f"*ELEMENT,TYPE=SPRING1,ELSET={name}", f"{number},{node + 1}"]
            lines += [f"*SPRING,ELSET={name}", f"{direction}", f"{spring[node]:.12g}"]
    lines += [
        "*MATERIAL,NAME=M", "*ELASTIC", f"{stuff.youngs_modulus_mpa},{stuff.poisson_ratio}",
        f"*EXPANSION,ZERO={stuff.stress_free_celsius}", f"{stuff.expansion_per_k}",
        "*CONDUCTIVITY", f"{stuff.conductivity_w_mk}", "*SPECIFIC HEAT", f"{stuff.heat_capacity_j_kgk * 1e6}",
        "*DENSITY", f"{stuff.density_kg_m3 * 1e-12}", "*SOLID SECTION,ELSET=EALL,MATERIAL=M",
        "*INITIAL CONDITIONS,TYPE=TEMPERATURE", f"NALL,{stuff.stress_free_celsius}",
        "*AMPLITUDE,NAME=AIR",
        f"0.,{stuff.stress_free_celsius},{protocol.ramp_s},{protocol.ambient_end_celsius}",
        "*STEP,INC=1000", "*UNCOUPLED TEMPERATURE-DISPLACEMENT,DIRECT", f"{protocol.step_s},{protocol.record_s}",
        "*FILM,AMPLITUDE=AIR",
    ]  # fmt: skip
    for label, corners in _FACES.items():
        hit = np.flatnonzero(np.isin(key(mesh.cells[:, corners]), outer))
        lines += [f"{i + 1},F{label},1.,{protocol.heat_transfer_coefficient_w_m2k * 1e-3}" for i in hit]
    lines += [f"*NODE PRINT,NSET=NALL,FREQUENCY={protocol.steps}", "U,NT"]
    lines += [f"*EL PRINT,ELSET=EALL,FREQUENCY={protocol.steps}", "S", "*END STEP", ""]
    return "\n".join(lines)


def results(path: Path) -> dict[str, np.ndarray]:
    """The last block of each kind in a .dat file: displacements, temperatures, stresses (xx yy zz xy xz yz)."""
    blocks: dict[str, list] = {}
    current: list = []
    for line in path.read_text(encoding="utf-8").splitlines():
        words = line.split()
        if words and words[0] in ("displacements", "temperatures", "stresses"):
            current = blocks[words[0]] = []
        elif words:
            current.append([float(w) for w in words])
    return {name: np.array(sorted(rows)) for name, rows in blocks.items()}


def compare(name: str, vertices, faces, edge_mm: float) -> dict:
    """Relative L2 differences of ours from CalculiX's."""
    stuff, protocol = material("pla"), PROTOCOL
    frame = fem.frame_of(vertices, 100.0)
    phi = signed_distance(frame.normalise(vertices), faces, 129)
    mesh, _ = tet_mesh.largest_component(tetrahedra.isosurface_stuffing(phi, edge_mm / frame.mm_per_unit))
    mesh = mesh.with_points(frame.to_print(mesh.points))
    started = time.process_time()
    ours = fem.solve(mesh, stuff, protocol)
    seconds = time.process_time() - started
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "job.inp").write_text(deck(ours, stuff, protocol), encoding="utf-8")
        started = time.perf_counter()
        run = subprocess.run(["ccx", "-i", "job"], cwd=folder, env=os.environ | {"OMP_NUM_THREADS": "1"},
                             capture_output=True, text=True)  # fmt: skip
        wall = time.perf_counter() - started
        if not Path(folder, "job.dat").exists() or "*ERROR" in run.stdout:
            raise RuntimeError(run.stdout[-3000:])
        theirs = results(Path(folder, "job.dat"))
    moved, temperature = theirs["displacements"][:, 1:4], theirs["temperatures"][:, 1]
    s = theirs["stresses"][:, 2:8]
    tensor = s[:, [0, 3, 4, 3, 1, 5, 4, 5, 2]].reshape(-1, 3, 3)
    weight, equivalent = ours.elements.volumes, von_mises(tensor)
    relative = lambda a, b, w=1.0: float(np.sqrt((w * (a - b) ** 2).sum() / (w * b**2).sum()))  # noqa: E731
    return {
        "shape": name,
        "nodes": len(mesh.points),
        "temperature": relative(ours.temperature - 60, temperature - 60),
        "displacement": relative(ours.displacement, moved),
        "von_mises": relative(ours.von_mises, equivalent, weight),
        "mean_mpa": [float(np.average(v, weights=weight)) for v in (ours.von_mises, equivalent)],
        "seconds_ours_cpu": round(seconds, 1),
        "seconds_ccx_wall": round(wall, 1),
    }


def main(shapes: dict[str, Path], edge_mm: float = 2.5) -> dict:
    if shutil.which("ccx") is None:
        sys.exit("skipped: ccx is not installed; apt-get install calculix-ccx")
    rows = []
    for name, path in shapes.items():
        rows.append(compare(name, *surface.load(path), edge_mm))
        print(rows[-1], flush=True)
    return {"edge_mm": edge_mm, "limits": {"displacement": 1e-3, "von_mises": 5e-3}, "rows": rows}


if __name__ == "__main__":
    verification.record("calculix", main({Path(p).stem: Path(p) for p in sys.argv[1:]}))

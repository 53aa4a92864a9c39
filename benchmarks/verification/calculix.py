"""CalculiX (Debian: calculix-ccx) on the same mesh and conditions: temperature, displacement and von Mises.

The soft clamp becomes grounded springs (SPRING1), one property per constrained node and direction.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks import record
from benchmarks.inputs import Inputs
from genmf_mi.core.timer import Timer
from genmf_mi.sdf.distance import signed_distance
from genmf_mi.stress.fem import simulation as fem
from genmf_mi.stress.fem import surface, tet_mesh, tetrahedra
from genmf_mi.stress.fem.elasticity import soft_clamp, von_mises
from genmf_mi.stress.fem.materials import Material, material
from genmf_mi.stress.fem.protocol import Protocol

SHAPES = ("rockerarm", "wingnut")
EDGE_MM, PROTOCOL = 2.5, Protocol(step_s=300.0)
"""Both programs take the same four steps; CalculiX factors its matrices anew in each."""
COARSE_SHAPE, COARSE_EDGE_MM, COARSE_PROTOCOL = "wingnut", 4.0, Protocol(step_s=60.0)
"""A coarse mesh with the steps of a simulation."""
LIMITS = {"displacement": 1e-3, "von_mises": 5e-3}
_FACES = {"1": [0, 1, 2], "2": [0, 1, 3], "3": [1, 2, 3], "4": [0, 2, 3]}
"""Corners of the faces of C3D4 in CalculiX's numbering."""


def deck(field: fem.Field, pla: Material, protocol: Protocol) -> str:
    """The input file; units t, mm, s, K (so mW for power)."""
    mesh, elements = field.mesh, field.elements
    n = len(mesh.points)
    key = lambda faces: np.sort(faces, axis=1) @ np.array([n * n, n, 1])  # noqa: E731
    outer = np.unique(key(mesh.boundary()))
    spring = soft_clamp(mesh.points[:, 2], elements.nodal_volume(), pla.youngs_modulus_mpa, protocol.clamp_fraction)
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
        "*MATERIAL,NAME=M", "*ELASTIC", f"{pla.youngs_modulus_mpa},{pla.poisson_ratio}",
        f"*EXPANSION,ZERO={pla.stress_free_celsius}", f"{pla.expansion_per_k}",
        "*CONDUCTIVITY", f"{pla.conductivity_w_mk}", "*SPECIFIC HEAT", f"{pla.heat_capacity_j_kgk * 1e6}",
        "*DENSITY", f"{pla.density_kg_m3 * 1e-12}", "*SOLID SECTION,ELSET=EALL,MATERIAL=M",
        "*INITIAL CONDITIONS,TYPE=TEMPERATURE", f"NALL,{pla.stress_free_celsius}",
        "*AMPLITUDE,NAME=AIR",
        f"0.,{pla.stress_free_celsius},{protocol.ramp_s},{protocol.ambient_end_celsius}",
        "*STEP,INC=1000", "*UNCOUPLED TEMPERATURE-DISPLACEMENT,DIRECT", f"{protocol.step_s},{protocol.record_s}",
        "*FILM,AMPLITUDE=AIR",
    ]  # fmt: skip
    for label, corners in _FACES.items():
        cells = np.flatnonzero(np.isin(key(mesh.cells[:, corners]), outer))
        lines += [f"{i + 1},F{label},1.,{protocol.heat_transfer_coefficient_w_m2k * 1e-3}" for i in cells]
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


def run(deck_text: str) -> tuple[dict[str, np.ndarray], float]:
    """The results of CalculiX for an input file, and its wall seconds. Raises :class:`RuntimeError` where it fails."""
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "job.inp").write_text(deck_text, encoding="utf-8")
        timer = Timer()
        done = subprocess.run(["ccx", "-i", "job"], cwd=folder, env=os.environ | {"OMP_NUM_THREADS": "1"},
                              capture_output=True, text=True, check=False)  # fmt: skip
        seconds = timer.total
        if not Path(folder, "job.dat").exists() or "*ERROR" in done.stdout:
            raise RuntimeError(done.stdout[-3000:])
        return results(Path(folder, "job.dat")), seconds


def compare(path: Path, edge_mm: float, protocol: Protocol) -> dict:
    """Relative L2 differences of ours from CalculiX's, for the shape in a file."""
    vertices, faces = surface.load(path)
    pla = material("pla")
    frame = fem.frame_of(vertices, 100.0)
    phi = signed_distance(frame.normalise(vertices), faces, 129)
    mesh, _ = tet_mesh.largest_component(tetrahedra.isosurface_stuffing(phi, edge_mm / frame.mm_per_unit))
    mesh = mesh.with_points(frame.to_print(mesh.points))
    start = time.process_time()
    ours = fem.solve(mesh, pla, protocol)
    seconds = time.process_time() - start
    theirs, ccx_seconds = run(deck(ours, pla, protocol))
    displacement, temperature = theirs["displacements"][:, 1:4], theirs["temperatures"][:, 1]
    tensor = theirs["stresses"][:, 2:8][:, [0, 3, 4, 3, 1, 5, 4, 5, 2]].reshape(-1, 3, 3)
    weight, equivalent = ours.elements.volumes, von_mises(tensor)

    def relative(a: np.ndarray, b: np.ndarray, weight: np.ndarray | float = 1.0) -> float:
        return float(np.sqrt((weight * (a - b) ** 2).sum() / (weight * b**2).sum()))

    start_celsius = pla.stress_free_celsius
    return {
        "shape": path.stem,
        "nodes": len(mesh.points),
        "temperature": relative(ours.temperature - start_celsius, temperature - start_celsius),
        "displacement": relative(ours.displacement, displacement),
        "von_mises": relative(ours.von_mises, equivalent, weight),
        "mean_mpa": [float(np.average(v, weights=weight)) for v in (ours.von_mises, equivalent)],
        "seconds_ours_cpu": round(seconds, 1),
        "seconds_ccx_wall": round(ccx_seconds, 1),
    }


def main(inputs: Inputs) -> None:
    """Compare on two shapes, and on a coarse mesh with the time steps of a simulation.

    Args:
        inputs: What all benchmarks have in common; this one reads --meshes.
    """
    if shutil.which("ccx") is None:
        raise SystemExit("error: the program ccx is not installed: apt-get install calculix-ccx")
    rows = []
    for path in inputs.mesh_files(SHAPES):
        rows.append(compare(path, EDGE_MM, PROTOCOL))
        print(rows[-1], flush=True)
    about = {"edge_mm": EDGE_MM, "step_s": PROTOCOL.step_s, "limits": LIMITS}
    record.write_verification("calculix", {**about, "rows": rows})
    (path,) = inputs.mesh_files((COARSE_SHAPE,))[:1]
    coarse = compare(path, COARSE_EDGE_MM, COARSE_PROTOCOL)
    about = {"edge_mm": COARSE_EDGE_MM, "step_s": COARSE_PROTOCOL.step_s}
    record.write_verification("calculix_coarse", {**about, "rows": [coarse]})

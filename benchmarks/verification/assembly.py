"""CPU seconds to assemble all P1 matrices of one mesh: the kernels of the solver beside scikit-fem."""

from __future__ import annotations

import numpy as np

from benchmarks import record
from benchmarks.inputs import Inputs
from benchmarks.record import cpu_seconds
from genmf_mi.stress.fem.assembly import P1
from genmf_mi.stress.fem.materials import material
from genmf_mi.stress.fem.reference import Forms
from genmf_mi.stress.fem.tetrahedra import TetMesh, isosurface_stuffing

EDGE_MM = 3.2
"""Gives about 20 000 nodes."""
PLA = material("pla")


def main(inputs: Inputs) -> None:
    """Assemble mass, stiffness and boundary matrices of heat and the stiffness of elasticity by either way.

    Args:
        inputs: What all benchmarks have in common; this one reads none of them.
    """
    mesh = ellipsoid(EDGE_MM)
    result = {
        "nodes": len(mesh.points),
        "own": cpu_seconds(lambda: assemble(mesh)),
        "scikit_fem": cpu_seconds(lambda: Forms(mesh, PLA)),
    }
    print(result, flush=True)
    record.write_verification("assembly_seconds_cpu", result)


def ellipsoid(edge_mm: float) -> TetMesh:
    """An ellipsoid of 100 × 66 × 84 mm."""
    ticks = np.linspace(-1, 1, 129)
    x, y, z = np.meshgrid(ticks, ticks, ticks, indexing="ij")
    mesh = isosurface_stuffing((np.sqrt((x / 0.95) ** 2 + (y / 0.63) ** 2 + (z / 0.8) ** 2) - 1) * 0.63, edge_mm / 52.6)
    return mesh.with_points(52.6 * mesh.points)


def assemble(mesh: TetMesh) -> None:
    """All that :class:`Forms` holds."""
    elements = P1(mesh)
    for matrix in (elements.stiffness, elements.mass, elements.boundary_mass, elements.boundary_load):
        matrix()
    elements.elastic(*PLA.lame)

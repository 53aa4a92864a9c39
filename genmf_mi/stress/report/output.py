"""The files of a simulation: ``stress.vtu``, ``stress.npz``, ``stress.json``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from genmf_mi.core.files import atomic, write_text
from genmf_mi.stress.fem.problem import Field
from genmf_mi.stress.fem.simulation import Simulation
from genmf_mi.stress.fem.tet_mesh import TetMesh

if TYPE_CHECKING:
    from genmf_mi.stress.model.predictor import NodalField, Prediction

FILES = ("stress.vtu", "stress.npz", "stress.json", "stress.png")
"""The files of one shape; to claim a folder for them, see :func:`genmf_mi.core.files.claim_folder`."""


def write_vtu(path: Path, field: Field) -> None:
    """The field on its mesh, for ParaView: mm, °C, MPa; z up. Stress is per cell, ``xx xy xz yx … zz``."""
    nodal = {
        "temperature_C": field.temperature,
        "displacement_mm": field.displacement,
        "von_mises_MPa": field.von_mises_nodes,
    }
    by_cell = {"stress_MPa": field.stress.reshape(-1, 9), "von_mises_cell_MPa": field.von_mises}
    _write_mesh(path, field.mesh, nodal, by_cell)


def write_prediction_vtu(path: Path, field: NodalField) -> None:
    """A predicted field on a mesh, for ParaView: mm, MPa; z up."""
    _write_mesh(path, field.mesh, {"von_mises_MPa": field.von_mises_nodes}, {})


def write_grid(path: Path, simulation: Simulation | Prediction) -> None:
    """Φ and von Mises on the grid, ``[x,y,z]`` over [-1, 1]³ with y up, and the frame that the grid stands in."""
    von_mises, _ = simulation.on_grid()
    frame = simulation.frame
    with atomic(path) as temporary:
        np.savez_compressed(
            temporary,
            phi=simulation.phi,
            von_mises_mpa=von_mises,
            centre=np.array(frame.centre),
            scale=frame.scale,
            size_mm=frame.size_mm,
        )


def write_json(path: Path, content: dict) -> None:
    write_text(path, json.dumps(content, indent=2) + "\n")


def _write_mesh(path: Path, mesh: TetMesh, nodal: dict[str, np.ndarray], by_cell: dict[str, np.ndarray]) -> None:
    import meshio

    single = np.float32
    content = meshio.Mesh(
        mesh.points,
        [("tetra", mesh.cells)],
        point_data={name: value.astype(single) for name, value in nodal.items()},
        cell_data={name: [value.astype(single)] for name, value in by_cell.items()},
    )
    with atomic(path) as temporary:
        meshio.write(temporary, content, file_format="vtu")

"""The files of a simulation: ``stress.vtu``, ``stress.npz``, ``stress.json``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from genmf_mi.core.errors import OutputError
from genmf_mi.core.files import atomic, write_text
from genmf_mi.stress.fem.simulation import Field, Simulation

if TYPE_CHECKING:
    from genmf_mi.stress.model.predictor import NodalField, Prediction

FILES = ("stress.vtu", "stress.npz", "stress.json", "stress.png")


def claim(out: Path, names: tuple[str, ...], force: bool) -> None:
    """Raises :class:`OutputError` if ``out`` holds one of the files already and ``force`` is not given."""
    there = [name for name in names if (out / name).exists()]
    if there and not force:
        raise OutputError(
            f"{out} holds {', '.join(there)} already; choose another --out, or replace them with --force."
        )
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot make {out}: {error.strerror}. Choose another --out.") from error


def write_vtu(path: Path, field: Field) -> None:
    """The field on its mesh, for ParaView: mm, °C, MPa; z up. Stress is per cell, ``xx xy xz yx … zz``."""
    import meshio

    single = np.float32
    mesh = meshio.Mesh(
        field.mesh.points,
        [("tetra", field.mesh.cells)],
        point_data={
            "temperature_C": field.temperature.astype(single),
            "displacement_mm": field.displacement.astype(single),
            "von_mises_MPa": field.von_mises_nodes.astype(single),
        },
        cell_data={
            "stress_MPa": [field.stress.reshape(-1, 9).astype(single)],
            "von_mises_cell_MPa": [field.von_mises.astype(single)],
        },
    )
    with atomic(path) as temporary:
        meshio.write(temporary, mesh, file_format="vtu")


def write_prediction_vtu(path: Path, field: NodalField) -> None:
    """A predicted field on a mesh, for ParaView: mm, MPa; z up."""
    import meshio

    mesh = meshio.Mesh(
        field.mesh.points,
        [("tetra", field.mesh.cells)],
        point_data={"von_mises_MPa": field.von_mises_nodes.astype(np.float32)},
    )
    with atomic(path) as temporary:
        meshio.write(temporary, mesh, file_format="vtu")


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

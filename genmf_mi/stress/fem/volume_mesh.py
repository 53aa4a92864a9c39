"""Volume meshes from files."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from genmf_mi.core.errors import SolidError
from genmf_mi.stress.fem.tet_mesh import TetMesh, compact

SUFFIXES = (".vtu", ".vtk", ".msh", ".mesh", ".xdmf", ".inp", ".bdf", ".med")
"""Suffixes that are read as volume meshes."""


def is_volume_mesh(path: str | Path) -> bool:
    """Whether ``path`` is read as a volume mesh, by its suffix."""
    return Path(path).suffix.lower() in SUFFIXES


def read(path: str | Path) -> TetMesh:
    """The tetrahedra of a volume mesh that meshio reads (VTU, MSH, MESH, XDMF, ...), in the units of the file.

    Raises:
        SolidError: unreadable, without tetrahedra, not numbers, or with cells of zero volume.
    """
    import meshio

    try:
        raw = meshio.read(path)
    except (SystemExit, Exception) as error:  # meshio ends the interpreter on some unreadable files
        raise SolidError(f"cannot read {path} as a volume mesh: {error}.") from error
    blocks = [block.data for block in raw.cells if block.type == "tetra"]
    if not blocks:
        raise SolidError(f"{path} holds no linear tetrahedra; export the volume mesh with element type tetra.")
    points = np.asarray(raw.points, dtype=np.float64)
    if not np.isfinite(points).all():
        raise SolidError(f"{path} has nodes that are not numbers; export the mesh again.")
    mesh = compact(points, np.concatenate(blocks).astype(np.int64))
    extent = float(np.ptp(mesh.points, axis=0).max())
    if np.abs(mesh.volumes).min() <= 1e-15 * extent**3:
        raise SolidError(f"{path} has tetrahedra of zero volume; repair the mesh first.")
    return mesh.oriented()

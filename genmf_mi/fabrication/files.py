"""The files of a part, each read back by another library before it counts as written."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from genmf_mi.core import memory
from genmf_mi.core.errors import OutputError
from genmf_mi.core.files import atomic
from genmf_mi.core.frame import Frame
from genmf_mi.fabrication.glb import write_glb
from genmf_mi.fabrication.threemf import write_3mf

PRINT_3MF, PRINT_STL, COLOURED_GLB = "refined.3mf", "refined.stl", "refined.glb"
_FLOAT32 = 1e-4
"""mm; STL and 3MF round to float32 or to six digits."""


def write(
    folder: str | Path, vertices: np.ndarray, faces: np.ndarray, frame: Frame, rgb: np.ndarray | None, title: str
) -> dict[str, str]:
    """Write ``refined.3mf``, ``refined.stl`` and ``refined.glb``, and read each back with another reader.

    The print files are in millimetres, z up, on z = 0; the GLB is in the asset's own frame, y up.

    Args:
        vertices: ``[V,3]`` in the normalised frame. faces: ``[F,3]``.
        rgb: ``[V,3]`` linear, for the vertex colours of the GLB.

    Returns:
        The path of each file by its suffix.

    Raises:
        OutputError: a file cannot be written, or does not read back as what was written.
    """
    folder, part_mm = Path(folder), frame.to_print(vertices)
    own = frame.restore(np.asarray(vertices, dtype=np.float64))
    jobs: tuple[tuple[str, np.ndarray, Callable[[Path], None], float], ...] = (
        (PRINT_3MF, part_mm, lambda path: write_3mf(path, part_mm, faces, title), _FLOAT32),
        (PRINT_STL, part_mm, lambda path: _write_stl(path, part_mm, faces, title), _FLOAT32),
        (COLOURED_GLB, own, lambda path: write_glb(path, own, faces, rgb, title), 1e-6 * np.ptp(own, axis=0).max()),
    )
    for name, points, writer, tolerance in jobs:
        with atomic(folder / name) as temporary:
            writer(temporary)
            _compare(temporary, points, faces, tolerance)
        memory.trim_malloc()  # reading XML back takes 200 MB in small pieces
    return {Path(name).suffix[1:]: str(folder / name) for name, *_ in jobs}


def _write_stl(path: Path, vertices: np.ndarray, faces: np.ndarray, title: str) -> None:
    from trimesh import Trimesh

    content = Trimesh(vertices, faces, process=False, metadata={"name": title}).export(file_type="stl")
    assert isinstance(content, bytes), "binary STL"
    path.write_bytes(content)


def _compare(path: Path, vertices: np.ndarray, faces: np.ndarray, tolerance: float) -> None:
    """Read ``path`` back and compare its triangles, corner by corner, with what was written."""
    found = _read(path)
    if found.shape != (len(faces), 3, 3) or not np.abs(found - vertices[faces]).max() <= tolerance:
        raise OutputError(f"{path.name} does not read back as it was written. Please report this, with the asset.")


def _read(path: Path) -> np.ndarray:
    """Triangle corners ``[F,3,3]`` by a reader that did not write the file: NumPy for STL, trimesh for the others."""
    if path.suffix == ".stl":
        record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
        return np.fromfile(path, dtype=record, offset=84)["corners"].astype(np.float64)
    from trimesh import load_mesh

    mesh = load_mesh(path, process=False)
    return np.asarray(mesh.vertices)[np.asarray(mesh.faces)]

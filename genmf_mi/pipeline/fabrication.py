"""Files to print, and the checks that a part must pass before anybody spends filament on it."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np

from genmf_mi.core.errors import OutputError
from genmf_mi.core.files import atomic
from genmf_mi.core.frame import Frame
from genmf_mi.mesh import topology
from genmf_mi.mesh.manifold import is_solid

PRINT_3MF, PRINT_STL, COLOURED_GLB = "refined.3mf", "refined.stl", "refined.glb"
THIN_SHARE = 1.0
"""Percentile of the wall thickness that is reported as the smallest: a few sharp edges always measure zero."""
_FLOAT32 = 1e-4
"""mm; STL and 3MF round to float32 or to six digits."""


def check(vertices_mm: np.ndarray, faces: np.ndarray) -> dict:
    """What a slicer would complain about.

    vertices_mm ``[V,3]``, faces ``[F,3]``. Returns ``watertight`` (closed, oriented outwards, and a manifold to
    manifold3d), ``bodies``, ``self_intersections`` (faces that cut through another), ``volume_mm3``, ``area_mm2``,
    ``size_mm`` (three extents) and ``min_thickness_mm`` (1st percentile of the distance through the wall, measured
    against the surface normal).
    """
    from genmf_mi.mesh import meshlab

    return {
        "watertight": bool(is_solid(vertices_mm, faces)),
        "bodies": int(topology.bodies(faces).max() + 1),
        "self_intersections": len(meshlab.self_intersections(vertices_mm, faces)),
        "volume_mm3": float(topology.volume(vertices_mm, faces)),
        "area_mm2": float(topology.areas(vertices_mm, faces).sum()),
        "size_mm": [float(x) for x in np.ptp(vertices_mm, axis=0)],
        "min_thickness_mm": min_thickness(vertices_mm, faces),
    }


def min_thickness(vertices_mm: np.ndarray, faces: np.ndarray, samples: int = 20_000) -> float:
    """1st percentile of the wall thickness in mm, over up to ``samples`` evenly spread faces: how far a ray from the
    middle of a face runs inside before it leaves; 0 if there is no inside."""
    from genmf_mi.render import bridge

    chosen = np.linspace(0, len(faces) - 1, min(samples, len(faces))).astype(int)
    walls = bridge.thickness(vertices_mm, faces, chosen)
    walls = walls[np.isfinite(walls)]
    return float(np.percentile(walls, THIN_SHARE)) if len(walls) else 0.0


def write(
    folder: str | Path, vertices: np.ndarray, faces: np.ndarray, frame: Frame, rgb: np.ndarray | None, title: str
) -> dict[str, str]:
    """Write ``refined.3mf``, ``refined.stl`` and ``refined.glb``, and read each back with another reader.

    vertices ``[V,3]`` in the normalised frame, faces ``[F,3]``; rgb ``[V,3]`` linear, for the GLB's vertex colours. The
    print files are in millimetres, z up, on z = 0; the GLB is in the asset's own frame, y up.

    Returns the path of each file by its suffix.

    Raises:
        OutputError: a file cannot be written, or does not read back as what was written.
    """
    folder, part_mm = Path(folder), frame.to_print(vertices)
    own = frame.restore(np.asarray(vertices, dtype=np.float64))
    jobs: tuple[tuple[str, np.ndarray, Callable[[Path], None], float], ...] = (
        (PRINT_3MF, part_mm, lambda path: _write_3mf(path, part_mm, faces, title), _FLOAT32),
        (PRINT_STL, part_mm, lambda path: _write_stl(path, part_mm, faces, title), _FLOAT32),
        (COLOURED_GLB, own, lambda path: write_glb(path, own, faces, rgb, title), 1e-6 * np.ptp(own, axis=0).max()),
    )
    for name, points, writer, tolerance in jobs:
        with atomic(folder / name) as temporary:
            writer(temporary)
            _compare(temporary, points, faces, tolerance)
    return {Path(name).suffix[1:]: str(folder / name) for name, *_ in jobs}


def _write_3mf(path: Path, vertices: np.ndarray, faces: np.ndarray, title: str) -> None:
    import lib3mf

    model = lib3mf.get_wrapper().CreateModel()
    model.SetUnit(lib3mf.ModelUnit.MilliMeter)
    metadata = model.GetMetaDataGroup()
    metadata.AddMetaData("", "Title", title, "xs:string", True)
    metadata.AddMetaData("", "Application", "genmf_mi", "xs:string", True)
    mesh = model.AddMeshObject()
    mesh.SetName(title)
    mesh.SetGeometry(
        [lib3mf.Position((x, y, z)) for x, y, z in vertices.astype(np.float32).tolist()],
        [lib3mf.Triangle((a, b, c)) for a, b, c in faces.tolist()],
    )
    model.AddBuildItem(mesh, lib3mf.get_wrapper().GetIdentityTransform())
    # WriteToFile aborts the process when the disk is full
    path.write_bytes(bytes(model.QueryWriter("3mf").WriteToBuffer()))


def _write_stl(path: Path, vertices: np.ndarray, faces: np.ndarray, title: str) -> None:
    from trimesh import Trimesh

    path.write_bytes(Trimesh(vertices, faces, process=False, metadata={"name": title}).export(file_type="stl"))


def write_glb(path: Path, vertices: np.ndarray, faces: np.ndarray, rgb: np.ndarray | None, title: str) -> None:
    """One primitive with normals and 16-bit COLOR_0: eight bits of linear light would show as bands in the dark."""
    attributes = {"POSITION": vertices.astype("<f4"), "NORMAL": topology.vertex_normals(vertices, faces).astype("<f4")}
    if rgb is not None:
        opaque = np.column_stack([np.clip(rgb, 0, 1), np.ones(len(rgb))])
        attributes["COLOR_0"] = np.rint(opaque * 65535).astype("<u2")
    arrays = [*attributes.values(), faces.astype("<u4").reshape(-1, 1)]
    offsets = np.cumsum([0] + [array.nbytes for array in arrays])
    components, shapes = {"<f4": 5126, "<u2": 5123, "<u4": 5125}, {1: "SCALAR", 3: "VEC3", 4: "VEC4"}
    accessors = [
        {"bufferView": index, "componentType": components[array.dtype.str], "count": len(array), "type": shapes[width]}
        for index, array in enumerate(arrays)
        for width in array.shape[1:]
    ]
    accessors[0] |= {"min": arrays[0].min(axis=0).tolist(), "max": arrays[0].max(axis=0).tolist()}
    if rgb is not None:
        accessors[2]["normalized"] = True
    primitive = {
        "attributes": {name: index for index, name in enumerate(attributes)},
        "indices": len(attributes),
        "material": 0,
    }
    tree = {
        "asset": {"version": "2.0", "generator": "genmf_mi"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": title}],
        "meshes": [{"name": title, "primitives": [primitive]}],
        "materials": [{"pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 0.8}}],
        "accessors": accessors,
        "bufferViews": [
            {"buffer": 0, "byteOffset": int(start), "byteLength": array.nbytes} for start, array in zip(offsets, arrays)
        ],
        "buffers": [{"byteLength": int(offsets[-1])}],
    }
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    with path.open("wb") as file:
        file.write(struct.pack("<4sII", b"glTF", 2, 12 + 8 + len(text) + 8 + int(offsets[-1])))
        file.write(struct.pack("<I4s", len(text), b"JSON") + text)
        file.write(struct.pack("<I4s", int(offsets[-1]), b"BIN\0"))
        for array in arrays:
            file.write(array.tobytes())


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

"""A coloured mesh as binary glTF 2.0."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np

from genmf_mi.mesh.measures import vertex_normals

FAR = 10.0
"""Distance from the origin, over the size of the mesh, from which on the node moves it."""


def write_glb(path: Path, vertices: np.ndarray, faces: np.ndarray, rgb: np.ndarray | None, title: str) -> None:
    """One primitive with normals and 16-bit COLOR_0: eight bits of linear light would show as bands in the dark.

    Far from the origin, as in scans with map coordinates, the positions are given about the middle, and the node moves
    them: the format has 24 bits for each.
    """
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    far = np.abs(vertices).max() > FAR * (high - low).max()
    origin = (low + high) / 2 if far else np.zeros(3)
    attributes = {
        "POSITION": (vertices - origin).astype("<f4"),
        "NORMAL": vertex_normals(vertices, faces).astype("<f4"),
    }
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
        "nodes": [{"mesh": 0, "name": title} | ({"translation": origin.tolist()} if far else {})],
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

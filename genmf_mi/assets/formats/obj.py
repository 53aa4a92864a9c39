"""Wavefront OBJ with its MTL.

General readers drop a texture that is missing on disk, the options of ``map_Kd``, every material library but the first,
and the colours of vertices that also have texture coordinates.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from genmf_mi.assets.albedo import Material
from genmf_mi.assets.formats import mtl, polygons
from genmf_mi.assets.part import Names, Part, decode_colours
from genmf_mi.core.errors import AssetError

Corner = tuple[int, int]
"""Index of a position, and of a texture coordinate or -1."""


def read(path: Path) -> list[Part]:
    """All faces of an OBJ file, one part per material.

    Colours (``Kd``, ``map_Kd``, vertex colours) are taken as sRGB-encoded. A texture takes precedence over vertex
    colours, and those over ``Kd``, in which exporters leave values without meaning.

    Raises:
        AssetError: a material library or a texture is missing, or a statement cannot be understood.
    """
    text = mtl.decoded(path.read_bytes())
    materials: dict[str, Material] = {}
    vertices, colours, uv, rings, used_libraries, groups = _statements(path, text)
    for names in used_libraries:
        materials |= mtl.libraries(path, names)
    parts = []
    for name, (pairs, owner) in _triangles(path, vertices, rings).items():
        material = replace(materials.get(name, Material()), name=name)
        used, faces = np.unique(np.array(pairs, dtype=np.int64), axis=0, return_inverse=True)
        if used.max(axis=0)[0] >= len(vertices) or used.min(axis=0)[0] < 0 or used.max(axis=0)[1] >= len(uv):
            raise AssetError(f"{path} has faces that point to missing vertices. Export it again.")
        if material.texture is not None and (used[:, 1] < 0).any():
            raise AssetError(
                f"{path} has no texture coordinates for the texture of material {name}. Unwrap it and export it again."
            )
        if material.texture is None and colours is not None:
            material = Material(name=name)
        names, group = _distinct([groups[name][row] for row in owner])
        parts.append(
            Part(
                vertices[used[:, 0]],
                faces.reshape(-1, 3),
                material,
                None if (used[:, 1] < 0).any() else uv[used[:, 1]],
                colours[used[:, 0]] if material.texture is None and colours is not None else None,
                names=names,
                group=group,
            )
        )
    return parts


def _statements(
    path: Path, text: str
) -> tuple[np.ndarray, np.ndarray | None, np.ndarray, dict[str, list[list[Corner]]], list[str], dict[str, list[Names]]]:
    """Positions ``[V,3]``, linear colours ``[V,3]`` or None, texture coordinates ``[T,2]`` with v downwards, the
    polygons of each material, what the ``mtllib`` lines name, and the names of the object and the groups of each
    polygon."""
    positions: list[list[float]] = []
    coordinates: list[tuple[float, float]] = []
    rings: dict[str, list[list[Corner]]] = {}
    libraries: list[str] = []
    names: dict[str, list[Names]] = {}
    material, object_name, group_names = "", "", ""
    for number, line in enumerate(text.replace("\\\n", " ").replace("\\\r\n", " ").splitlines(), start=1):
        key, rest = mtl.statement(line)
        try:
            if key == "v":
                positions.append([float(word) for word in rest.split("#")[0].split()])
            elif key == "vt":
                words = rest.split("#")[0].split()
                coordinates.append((float(words[0]), 1 - float(words[1]) if len(words) > 1 else 1.0))
            elif key == "usemtl":
                material = mtl.name_of(rest)
            elif key == "mtllib":
                libraries.append(rest)
            elif key == "o":
                object_name = rest
            elif key == "g":
                group_names = rest
            elif key == "f":
                words = rest.split("#")[0].split()
                ring = [_corner(word, len(positions), len(coordinates)) for word in words]
                rings.setdefault(material, []).append(ring)
                names.setdefault(material, []).append((object_name, *group_names.split()))
        except (ValueError, IndexError):
            raise AssetError(
                f"line {number} of {path} cannot be understood: {line.strip()[:60]!r}. Export it again."
            ) from None
    if any(len(row) < 3 for row in positions):
        raise AssetError(f"{path} has vertices with less than three coordinates. Export it again.")
    vertices = np.array([row[:3] for row in positions], dtype=np.float64).reshape(-1, 3)
    colours = None
    if positions and all(len(row) in (6, 7) for row in positions):
        colours = decode_colours(np.array([row[3:6] for row in positions]), path)
    return vertices, colours, np.array(coordinates, dtype=np.float64).reshape(-1, 2), rings, libraries, names


def _corner(word: str, positions: int, coordinates: int) -> Corner:
    """``7/3/1`` or ``-1//2``; negative numbers count from the last one so far."""
    numbers = [int(number) if number else 0 for number in word.split("/")[:2]]
    position, uv = numbers if len(numbers) > 1 else (numbers[0], 0)
    position = position - 1 if position > 0 else positions + position
    return position, uv - 1 if uv >= 0 else coordinates + uv


def _distinct(names: list[Names]) -> tuple[tuple[Names, ...], np.ndarray]:
    """The different names among those of some faces, and which of them each face has; the empty one is none."""
    found: dict[Names, int] = {}
    group = [found.setdefault(tuple(name for name in each if name), len(found)) for each in names]
    return tuple(found), np.array(group, dtype=np.int64)


def _triangles(
    path: Path, vertices: np.ndarray, rings: dict[str, list[list[Corner]]]
) -> dict[str, tuple[list[Corner], np.ndarray]]:
    """For each material the corners of its triangles, and of which polygon each triangle is."""
    corners: dict[str, tuple[list[Corner], np.ndarray]] = {}
    for name, some in rings.items():
        if any(not 0 <= position < len(vertices) for ring in some for position, _ in ring):
            raise AssetError(f"{path} has faces that point to missing vertices. Export it again.")
        owner, corner = polygons.triangles(vertices, [[position for position, _ in ring] for ring in some])
        if len(owner):
            found = [some[row][k] for row, three in zip(owner, corner, strict=True) for k in three]
            corners[name] = found, owner
    return corners

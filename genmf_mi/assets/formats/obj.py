"""Wavefront OBJ with its MTL.

General readers drop a texture that is missing on disk, the options of ``map_Kd``, every material library but the first,
and the colours of vertices that also have texture coordinates.
"""

from __future__ import annotations

import re
import shlex
from itertools import pairwise
from pathlib import Path

import numpy as np

from genmf_mi.assets.albedo import CLAMP, REPEAT, Material, Texture
from genmf_mi.assets.part import Part, decode_image
from genmf_mi.core import colour
from genmf_mi.core.errors import AssetError

_ARGUMENTS = {
    "-o": 3, "-s": 3, "-t": 3, "-mm": 2, "-blendu": 1, "-blendv": 1, "-cc": 1, "-clamp": 1, "-texres": 1, "-bm": 1,
    "-imfchan": 1, "-type": 1,
}  # fmt: skip


def read(path: Path) -> list[Part]:
    """All faces of an OBJ file, one part per material; polygons become fans.

    Colours (``Kd``, ``map_Kd``, vertex colours) are taken as sRGB-encoded. A texture takes precedence over vertex
    colours, and those over ``Kd``, in which exporters leave values without meaning.

    Raises:
        AssetError: a material library or a texture is missing.
    """
    text = path.read_text(encoding="utf-8", errors="replace")
    materials = {}
    for name in re.findall(r"^mtllib\s+(.+?)\s*$", text, flags=re.MULTILINE):
        materials |= _library(path, path.parent / name)
    vertices, colours, uv, corners = _statements(text)
    parts = []
    for name, pairs in corners.items():
        material = materials.get(name, Material())
        used, faces = np.unique(np.array(pairs, dtype=np.int64), axis=0, return_inverse=True)
        if used.max(axis=0)[0] >= len(vertices) or used.min(axis=0)[0] < 0 or used.max(axis=0)[1] >= len(uv):
            raise AssetError(f"{path} has faces that point to missing vertices. Export it again.")
        if material.texture is not None and (used[:, 1] < 0).any():
            raise AssetError(
                f"{path} has no texture coordinates for the texture of material {name}. Unwrap it and export it again."
            )
        if material.texture is None and colours is not None:
            material = Material()
        parts.append(
            Part(
                vertices[used[:, 0]],
                faces.reshape(-1, 3),
                material,
                None if material.texture is None else uv[used[:, 1]],
                colours[used[:, 0]] if material.texture is None and colours is not None else None,
            )
        )
    return parts


def _statements(text: str) -> tuple[np.ndarray, np.ndarray | None, np.ndarray, dict[str, list[tuple[int, int]]]]:
    """Positions ``[V,3]``, linear colours ``[V,3]`` or None, texture coordinates ``[T,2]`` with v downwards, and for
    each material the corners of its triangles as (position, texture coordinate or -1), counted from 0."""
    positions, coordinates, corners, material = [], [], {}, ""
    for line in text.replace("\\\n", " ").splitlines():
        key, *words = line.split("#", 1)[0].split() or [""]
        if key == "v":
            positions.append([float(word) for word in words])
        elif key == "vt":
            coordinates.append((float(words[0]), 1 - float(words[1]) if len(words) > 1 else 1.0))
        elif key == "usemtl":
            material = line.strip()[6:].strip()
        elif key == "f":
            ring = []
            for word in words:
                numbers = [int(number) if number else 0 for number in word.split("/")[:2]]
                position, uv = numbers if len(numbers) > 1 else (numbers[0], 0)
                position = position - 1 if position > 0 else len(positions) + position
                ring.append((position, uv - 1 if uv >= 0 else len(coordinates) + uv))
            into = corners.setdefault(material, [])
            for second, third in pairwise(ring[1:]):
                into += (ring[0], second, third)
    vertices = np.array([row[:3] for row in positions], dtype=np.float64).reshape(-1, 3)
    colours = None
    if positions and all(len(row) in (6, 7) for row in positions):
        rgb = np.array([row[3:6] for row in positions])
        colours = colour.to_linear(np.clip(rgb / 255 if rgb.max() > 1 else rgb, 0, 1))
    return vertices, colours, np.array(coordinates, dtype=np.float64).reshape(-1, 2), corners


def _library(obj: Path, path: Path) -> dict[str, Material]:
    try:
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        raise AssetError(
            f"{obj} refers to the materials {path.name}, which are not beside it. "
            "Put that file there, or delete the mtllib line."
        ) from None
    materials, name = {}, None
    for line in lines:
        key, _, rest = line.strip().partition(" ")
        key, rest = key.lower(), rest.strip()
        if key == "newmtl":
            name = rest
            materials[name] = Material()
        elif key == "kd" and name is not None and materials[name].texture is None:
            numbers = rest.split()
            if numbers[0] in ("spectral", "xyz"):
                raise AssetError(f"{path} gives Kd as {numbers[0]}. Write it as three RGB numbers.")
            rgb = np.array((numbers * 3)[:3] if len(numbers) == 1 else numbers[:3], dtype=np.float64)
            red, green, blue = map(float, colour.to_linear(rgb))
            materials[name] = Material((red, green, blue))
        elif key == "map_kd" and name is not None:
            materials[name] = Material(texture=_texture(obj, path.parent, rest))
    return materials


def _texture(obj: Path, folder: Path, statement: str) -> Texture:
    """A ``map_Kd`` statement: options, then a file name that may hold spaces."""
    wrap, scale, offset = REPEAT, np.ones(3), np.zeros(3)
    words = shlex.split(statement.replace("\\", "/"), posix=True)
    while words and words[0] in _ARGUMENTS:
        option, count = words.pop(0), 0
        values = []
        while words and count < _ARGUMENTS[option] and (count == 0 or _is_number(words[0])):
            values.append(words.pop(0))
            count += 1
        if option == "-clamp" and values[0] == "on":
            wrap = CLAMP
        elif option in ("-s", "-o"):
            target = scale if option == "-s" else offset
            target[: len(values)] = np.array(values, dtype=np.float64)
    name = " ".join(words)
    path = folder / name
    try:
        data = path.read_bytes()
    except OSError:
        raise AssetError(
            f"{obj} uses the texture {name}, which is not at {path}. Put it there, or correct map_Kd in the MTL file."
        ) from None
    # OBJ's v points up and the options act there, v' = s·v + o; ours points down: 1 - v' = s·(1 - v) + o.
    transform = np.array([[scale[0], 0, offset[0]], [0, scale[1], 1 - scale[1] - offset[1]]])
    return Texture(decode_image(data, str(path)), (wrap, wrap), transform=transform)


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True

"""PLY, through trimesh, with the colours and the checks that it leaves out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from trimesh.visual import ColorVisuals, TextureVisuals

from genmf_mi.assets.albedo import Material, Texture
from genmf_mi.assets.formats import beside
from genmf_mi.assets.part import Part, decode_colours, decode_image
from genmf_mi.core import colour
from genmf_mi.core.errors import AssetError


def read(path: Path) -> list[Part]:
    """The mesh of a file as one part, none if it has no faces.

    Colours are taken as sRGB-encoded. A texture takes precedence over vertex colours, and those over face colours.

    Raises:
        AssetError: several textures, or a texture that is missing or has no texture coordinates.
    """
    textures = _textures(path)
    if len(textures) > 1:
        raise AssetError(f"{path} uses {len(textures)} textures. Export it as GLB, or bake them into one.")
    data = beside.read(path, textures[0]) if textures else None
    if textures and data is None:
        raise AssetError(f"{path} uses the texture {textures[0]}, which is not beside it. Put it there.")
    mesh = trimesh.load(path, process=False)
    if not isinstance(mesh, trimesh.Trimesh):
        return []
    vertices, faces = np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int64)
    visual = mesh.visual
    if textures:
        if not isinstance(visual, TextureVisuals) or visual.uv is None:
            raise AssetError(f"{path} names a texture but has no texture coordinates. Unwrap it and export it again.")
        assert data is not None
        texture = Texture(decode_image(data, textures[0]))
        uv = np.column_stack([visual.uv[:, 0], 1 - visual.uv[:, 1]])
        return [Part(vertices, faces, Material(texture=texture), uv)]
    colours = _vertex_colours(path, mesh)
    if colours is not None:
        return [Part(vertices, faces, Material(), colours=colours)]
    if isinstance(visual, ColorVisuals) and visual.kind == "face":
        corners = np.repeat(colour.bytes_to_linear(visual.face_colors[:, :3]), 3, axis=0)
        separate = np.arange(3 * len(faces)).reshape(-1, 3)
        return [Part(vertices[faces].reshape(-1, 3), separate, Material(), colours=corners)]
    return [Part(vertices, faces, Material())]


_NAMES = (
    ("red", "green", "blue"),
    ("diffuse_red", "diffuse_green", "diffuse_blue"),
    ("r", "g", "b"),
    ("f_dc_0", "f_dc_1", "f_dc_2"),
)
"""What writers call the colour of a vertex."""
_SPLATS = "f_dc_0"


def _vertex_colours(path: Path, mesh: trimesh.Trimesh) -> np.ndarray | None:
    """Linear RGB ``[V,3]`` of the vertices under any of the usual names and in any type, or None."""
    raw: Any = mesh.metadata.get("_ply_raw", {}).get("vertex", {})
    data = raw.get("data")
    names: dict[str, str] = {str(name).lower(): str(name) for name in raw.get("properties", {})}
    chosen = next((three for three in _NAMES if all(name in names for name in three)), None)
    if chosen is None or data is None:
        return None
    if chosen[0] == _SPLATS:
        raise AssetError(f"{path} holds Gaussian splats, which have no surface. Convert it to a mesh.")
    columns = [np.asarray(data[names[name]]) for name in chosen]
    rgb = np.stack([np.ravel(column) for column in columns], axis=1)
    if len(rgb) != len(mesh.vertices):
        return None
    if rgb.dtype.kind in "iu":
        return colour.to_linear(rgb / float(np.iinfo(rgb.dtype).max)).astype(np.float32)
    return decode_colours(rgb.astype(np.float64), path).astype(np.float32)


def _textures(path: Path) -> list[str]:
    """The texture files that the header of a PLY file names, in MeshLab's comments."""
    names = []
    with path.open("rb") as handle:
        for line in handle:
            words = line.decode("latin-1").split(maxsplit=2)
            if words[:2] == ["comment", "TextureFile"]:
                names.append(words[2].strip())
            if words[:1] == ["end_header"]:
                break
    return names

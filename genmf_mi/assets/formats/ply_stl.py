"""PLY and STL, through trimesh, with the checks that it leaves out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh
from trimesh.visual import ColorVisuals, TextureVisuals

from genmf_mi.assets.albedo import Material, Texture
from genmf_mi.assets.part import Part, decode_image
from genmf_mi.core import colour
from genmf_mi.core.errors import AssetError


def read(path: Path) -> list[Part]:
    """The mesh of a file as one part, none if it has no faces.

    Colours are taken as sRGB-encoded. A texture takes precedence over vertex colours, and those over face colours.

    Raises:
        AssetError: a truncated STL, several textures, or a texture that is missing or has no texture coordinates.
    """
    ply = path.suffix.lower() == ".ply"
    textures = _textures(path) if ply else []
    if len(textures) > 1:
        raise AssetError(f"{path} uses {len(textures)} textures. Export it as GLB, or bake them into one.")
    if textures and not (path.parent / textures[0]).is_file():
        raise AssetError(f"{path} uses the texture {textures[0]}, which is not beside it. Put it there.")
    if not ply:
        _require_complete_stl(path)
    mesh = trimesh.load(path, process=False)
    if not isinstance(mesh, trimesh.Trimesh):
        return []
    vertices, faces = np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int64)
    visual = mesh.visual
    if textures:
        if not isinstance(visual, TextureVisuals) or visual.uv is None:
            raise AssetError(f"{path} names a texture but has no texture coordinates. Unwrap it and export it again.")
        texture = Texture(decode_image((path.parent / textures[0]).read_bytes(), textures[0]))
        uv = np.column_stack([visual.uv[:, 0], 1 - visual.uv[:, 1]])
        return [Part(vertices, faces, Material(texture=texture), uv)]
    if isinstance(visual, ColorVisuals) and visual.kind == "vertex":
        return [Part(vertices, faces, Material(), colours=colour.bytes_to_linear(visual.vertex_colors[:, :3]))]
    if isinstance(visual, ColorVisuals) and visual.kind == "face":
        corners = np.repeat(colour.bytes_to_linear(visual.face_colors[:, :3]), 3, axis=0)
        separate = np.arange(3 * len(faces)).reshape(-1, 3)
        return [Part(vertices[faces].reshape(-1, 3), separate, Material(), colours=corners)]
    return [Part(vertices, faces, Material())]


def _require_complete_stl(path: Path) -> None:
    """trimesh takes a truncated binary file for text."""
    with path.open("rb") as handle:
        head = handle.read(84)
    text = head.lstrip().startswith(b"solid")
    if not text and path.stat().st_size != 84 + 50 * int.from_bytes(head[80:], "little"):
        raise AssetError(f"{path} is truncated, or not an STL file. Download or export it again.")


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

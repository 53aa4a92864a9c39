"""Where an asset shall have relief, as told by an image, by vertex colours, or by the names in its file.

A mask is a number from 0, flat, to 1, full relief, at any point of the surface.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from genmf_mi.assets.albedo import Texture
from genmf_mi.assets.asset import Asset, load
from genmf_mi.assets.part import decode_image
from genmf_mi.core.colour import to_srgb, value
from genmf_mi.core.errors import AssetError, ConfigError
from genmf_mi.core.regions import MASK_MESHES
from genmf_mi.mesh.nearest import barycentric

Mask = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""From points and unit normals ``[N,3]``, in the coordinates of the asset, to 0..1 ``[N]``."""


@dataclass(frozen=True, eq=False)
class ImageMask:
    """An image over the asset's texture coordinates, moved and repeated as its texture is.

    asset: with texture coordinates. pixels: ``uint8 [H,W,3]``, sRGB-encoded; white is full relief, black is flat.
    """

    asset: Asset
    pixels: np.ndarray

    def __call__(self, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        asset, albedo = self.asset, self.asset.albedo
        index, closest = asset.locate(points, normals)
        corners = asset.faces[index]
        weights = barycentric(asset.vertices[corners], closest)
        uv = np.einsum("nc,nck->nk", weights, albedo.uv[corners])
        mapped = np.ptp(albedo.uv[corners], axis=1).any(axis=1)  # what is not on the map at all has its relief
        result = np.ones(len(points))
        for number, material in enumerate(albedo.materials):
            rows = np.flatnonzero((albedo.material[index] == number) & mapped)
            if len(rows):
                texture = material.texture or Texture(self.pixels)
                texture = replace(texture, pixels=self.pixels, nearest=False, alpha=None)
                result[rows] = to_srgb(value(texture.sample(uv[rows])))
        return result


def of_image(asset: Asset, path: Path) -> ImageMask:
    """The mask in an image file.

    Raises:
        ConfigError: the file cannot be read, or the asset has no texture coordinates.
    """
    if not np.ptp(asset.albedo.uv, axis=0).any():
        raise ConfigError(
            f"{asset.name} has no texture coordinates, so the image {path} cannot be laid over it. "
            f"Paint strokes (--regions), or give a mesh with vertex colours ({', '.join(MASK_MESHES)})."
        )
    try:
        return ImageMask(asset, decode_image(path.read_bytes(), path.name))
    except (OSError, AssetError) as error:
        raise ConfigError(f"cannot read the mask {path}: {error}") from error


def of_mesh(path: Path, up: str | None = None) -> Mask:
    """The mask in the colours of a mesh in the pose of the asset.

    Args:
        up: of its file, see :func:`genmf_mi.load`.

    Raises:
        ConfigError: the file cannot be read, or has no colours.
    """
    try:
        mesh = load(path, up)
    except AssetError as error:
        raise ConfigError(f"cannot read the mask: {error}") from error
    if not mesh.textured:
        raise ConfigError(f"the mask {path} has one colour all over. Paint its vertices black where it shall be flat.")
    return lambda points, normals: to_srgb(value(mesh.closest_albedo(points, normals)))


def of_vertex_colours(asset: Asset) -> tuple[Asset, Mask]:
    """The asset without its vertex colours, and the mask that they are. Raises :class:`ConfigError` without any."""
    if not np.ptp(asset.albedo.colours, axis=0).any():
        raise ConfigError(f"{asset.name} has no vertex colours that differ, so they are no mask.")
    white = replace(asset, albedo=replace(asset.albedo, colours=np.ones_like(asset.albedo.colours)))

    def mask(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        index, closest = asset.locate(points, normals)
        corners = asset.faces[index]
        weights = barycentric(asset.vertices[corners], closest)
        return to_srgb(value(np.einsum("nc,nck->nk", weights, asset.albedo.colours[corners])))

    return white, mask


def is_mesh(path: Path) -> bool:
    """Whether the file of a mask is a mesh and not an image."""
    return path.suffix.lower() in MASK_MESHES


def of_names(asset: Asset, materials: Iterable[str], faces: Iterable[str]) -> Mask:
    """The mask that is 0 on the faces of some materials, and on those of some objects and groups, by their names.

    Raises:
        ConfigError: there is no such name; the message lists those that there are.
    """
    materials, faces, albedo = set(materials), set(faces), asset.albedo
    used = {albedo.materials[number].name for number in np.unique(albedo.material)}
    _require_known(asset.name, "material", materials, used)
    _require_known(asset.name, "object or group", faces, {name for names in asset.groups for name in names})
    of_material = np.array([material.name in materials for material in albedo.materials])[albedo.material]
    of_group = np.array([bool(faces.intersection(names)) for names in asset.groups])[asset.group]
    flat = of_material | of_group
    return lambda points, normals: 1.0 - flat[asset.locate(points, normals)[0]]


def _require_known(name: str, what: str, asked: set[str], known: set[str]) -> None:
    known = known - {""}
    if missing := sorted(asked - known):
        there = f"Choose among: {', '.join(sorted(known))}." if known else f"Its file names no {what}."
        raise ConfigError(f"{name} has no {what} named {', '.join(missing)}. {there}")

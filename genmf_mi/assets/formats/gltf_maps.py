"""Normal, occlusion and emissive maps of glTF materials (3.9.3), KHR_materials_emissive_strength among them.

A file must not fail for a map that cannot be used: it is left out, and that is said.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from genmf_mi.assets.albedo import Texture
from genmf_mi.assets.maps import Layer, Maps, glows_all_over, is_flat
from genmf_mi.core.errors import AssetError
from genmf_mi.core.text import printable

Lookup = Callable[[dict[str, Any]], tuple[Texture, int]]
"""From a reference to a texture to what it is, and the UV set that it uses."""
Attribute = Callable[[str], np.ndarray | None]
"""From the name of an attribute of a primitive to its ``[V,K]``, None if the primitive lacks it."""
_BLACK = 0.02
"""Largest channel of a base colour that shows nothing."""
_UNUSABLE = AssetError, AttributeError, KeyError, IndexError, TypeError, ValueError
_FINEST, _STEEPEST = 4096, 100.0
"""Texels along a side of what is kept of a normal or occlusion map, and largest scale of a normal map."""


def emission_of(material: dict[str, Any]) -> tuple[float, float, float]:
    """The linear RGB that a material gives off, or that multiplies its emissive picture."""
    strength = material.get("extensions", {}).get("KHR_materials_emissive_strength", {}).get("emissiveStrength", 1.0)
    red, green, blue = (float(strength) * float(x) for x in material.get("emissiveFactor", [0, 0, 0])[:3])
    return red, green, blue


def emission_is_the_colour(material: dict[str, Any], factor: list[float], picture: np.ndarray | None) -> bool:
    """Whether what a material without a base picture gives off is its colour, as in shadeless scans.

    factor: of its base colour. picture: the emissive one, ``[H,W,3]``. Lamps on a body of one colour only add to it.
    """
    if not any(emission_of(material)):
        return False
    return max(factor[:3]) <= _BLACK or (picture is not None and glows_all_over(picture))


def maps_of(
    material: dict[str, Any], texture: Lookup, attribute: Attribute, *, emission: bool
) -> tuple[Maps, list[str]]:
    """The maps of a primitive, and what was left out, a sentence each.

    emission: whether what the material gives off is not its base colour already.
    """
    notes: list[str] = []

    def layer(key: str) -> Layer | None:
        if material.get(key) is None:
            return None
        try:
            picture, uv_set = texture(material[key])
            uv = attribute(f"TEXCOORD_{uv_set}")
            if uv is None or uv.shape[1:] != (2,) or not np.isfinite(uv).all():
                raise AssetError(f"it needs texture coordinates, TEXCOORD_{uv_set}")
            data = key != "emissiveTexture"
            finer = max(picture.pixels.shape[:2]) // _FINEST
            return Layer(picture.reduced(finer) if data else picture, uv.astype(np.float64))
        except _UNUSABLE as error:
            notes.append(f"the {key} of the material {printable(str(material.get('name', '')))!r} is left out: {error}")
            return None

    normal, occlusion = layer("normalTexture"), layer("occlusionTexture")
    if normal is not None and is_flat(normal.texture.pixels):
        normal = None
    if occlusion is not None and occlusion.texture.pixels[..., 0].min() == 255:
        occlusion = None
    emissive, given = None, (0.0, 0.0, 0.0)
    if emission and any(emission_of(material)):
        emissive = layer("emissiveTexture")
        if emissive is None or emissive.texture.pixels.any():
            given = emission_of(material)
    frame = _frame(attribute) if normal is not None else (None, None)
    scale = _number(material, "normalTexture", "scale", -_STEEPEST, _STEEPEST)
    strength = _number(material, "occlusionTexture", "strength", 0.0, 1.0)
    return Maps(normal, scale, *frame, occlusion if strength else None, strength, emissive, given), notes


def _number(material: dict[str, Any], key: str, name: str, low: float, high: float) -> float:
    given = material.get(key)
    number = given.get(name, 1.0) if isinstance(given, dict) else 1.0
    return float(np.clip(number, low, high)) if isinstance(number, int | float) and np.isfinite(number) else 1.0


def _frame(attribute: Attribute) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Tangents and bitangents ``[V,3]`` that the file gives (3.7.2.1), None if it gives none, or none that can be
    used."""
    tangents, normals = attribute("TANGENT"), attribute("NORMAL")
    if tangents is None or normals is None or tangents.shape[1:] != (4,) or not np.isfinite(tangents).all():
        return None, None
    along = tangents[:, :3].astype(np.float64)
    if np.linalg.norm(along, axis=1).min() < 1e-3:
        return None, None
    return along, np.cross(normals, along) * tangents[:, 3:]

"""The parts of an asset as its file stores them, and how they become one mesh with one albedo."""

from __future__ import annotations

import io
import struct
import warnings
from dataclasses import dataclass, replace
from hashlib import sha256
from typing import IO, TYPE_CHECKING

import numpy as np

from genmf_mi.assets.albedo import Albedo, Material
from genmf_mi.assets.maps import NO_MAPS, Maps, PlacedMaps
from genmf_mi.assets.reading import current
from genmf_mi.core import colour
from genmf_mi.core.errors import AssetError

if TYPE_CHECKING:
    from PIL.Image import Image
    from PIL.ImageFile import ImageFile

_KINDS = ("PNG", "JPEG", "WEBP", "BMP", "TIFF", "TGA", "GIF", "PPM", "PSD", "DDS", "PCX", "SGI", "JPEG2000")
_ROWS = 256


Names = tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Part:
    """Triangles that share a material.

    vertices: ``float64 [V,3]``; faces: ``int64 [F,3]``.
    uv: ``[V,2]`` with v downwards, or None; colours: linear RGB ``[V,3]``, or None.
    maps: normal, occlusion and emissive maps. notes: what the reader left out or mended, a sentence each.
    names: what the file calls groups of these faces, several names for a face that is in several.
    group: ``int64 [F]``, which of ``names`` a face has; None if all have the first.
    """

    vertices: np.ndarray
    faces: np.ndarray
    material: Material
    uv: np.ndarray | None = None
    colours: np.ndarray | None = None
    maps: Maps = NO_MAPS
    notes: tuple[str, ...] = ()
    names: tuple[Names, ...] = ((),)
    group: np.ndarray | None = None

    def transformed(self, matrix: np.ndarray) -> Part:
        """The part under an affine ``matrix [4,4]``; a mirroring one reverses the faces, so that they stay outwards."""
        with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is refused once it is all together
            vertices = self.vertices @ matrix[:3, :3].T + matrix[:3, 3]
            mirrors = np.linalg.slogdet(matrix[:3, :3])[0] < 0
        faces = self.faces[:, ::-1] if mirrors else self.faces
        return replace(self, vertices=vertices, faces=faces, maps=self.maps.turned(matrix[:3, :3]))


def join(parts: list[Part]) -> tuple[np.ndarray, np.ndarray, Albedo]:
    """Vertices ``[V,3]``, faces ``[F,3]`` and albedo of all parts together."""
    starts = np.cumsum([0] + [len(part.vertices) for part in parts[:-1]])
    materials = list({id(part.material): part.material for part in parts}.values())
    index = {id(material): number for number, material in enumerate(materials)}
    white, origin = np.ones((1, 3), np.float32), np.zeros((1, 2))

    def stack(arrays: list[np.ndarray | None], fallback: np.ndarray) -> np.ndarray:
        return np.concatenate(
            [
                np.broadcast_to(fallback, (len(part.vertices), fallback.shape[1])) if array is None else array
                for part, array in zip(parts, arrays)
            ]
        ).astype(fallback.dtype)

    return (
        np.concatenate([part.vertices for part in parts]).astype(np.float64),
        np.concatenate([part.faces + start for part, start in zip(parts, starts)]).astype(np.int64),
        Albedo(
            materials=tuple(materials),
            material=np.concatenate([np.full(len(part.faces), index[id(part.material)]) for part in parts]),
            uv=stack([part.uv for part in parts], origin),
            colours=stack([part.colours for part in parts], white),
        ),
    )


def placed_maps(parts: list[Part]) -> tuple[PlacedMaps, ...]:
    """The maps of all parts together, as :func:`join` puts them."""
    vertices, faces = (np.cumsum([0] + [len(getattr(part, name)) for part in parts]) for name in ("vertices", "faces"))
    return tuple(
        PlacedMaps(part.maps, int(faces[i]), int(faces[i + 1]), int(vertices[i]))
        for i, part in enumerate(parts)
        if part.maps.present
    )


def groups(parts: list[Part]) -> tuple[tuple[Names, ...], np.ndarray]:
    """The distinct names of groups of faces of all parts together, and which of them each face has, ``int64 [F]``."""
    found: dict[Names, int] = {}
    rows: list[np.ndarray] = []
    for part in parts:
        numbers = np.array([found.setdefault(names, len(found)) for names in part.names], dtype=np.int64)
        rows.append(numbers[np.zeros(len(part.faces), np.int64) if part.group is None else part.group])
    return tuple(found), np.concatenate(rows)


def decode_alpha(data: bytes) -> np.ndarray | None:
    """How opaque an image file is, ``uint8 [H,W]``; None if all of it is. It has been decoded before."""
    with open_image(io.BytesIO(data)) as image:
        if not (image.mode in ("RGBA", "LA", "PA") or "transparency" in image.info):
            return None
        band = image if image.mode in ("RGBA", "LA") else image.convert("RGBA")
        alpha = np.asarray(band.getchannel("A"))
    return None if alpha.min() == 255 else alpha


def decode_colours(rgb: np.ndarray, where: object) -> np.ndarray:
    """Linear RGB of sRGB-encoded numbers of a text or of floats, of 0..1 or 0..255; any shape.

    Raises:
        AssetError: some are NaN or infinite: the scale of all others would be lost.
    """
    if not np.isfinite(rgb).all():
        raise AssetError(f"{where} has colours that are not numbers. Export it again.")
    return colour.numbers_to_linear(rgb)


def decode_image(data: bytes, name: str) -> np.ndarray:
    """An image file as sRGB-encoded ``uint8 [H,W,3]``, not to be written to; transparency is dropped.

    Args:
        data: the content of the file.
        name: of the file, for messages.

    Raises:
        AssetError: the image cannot be decoded, or is too large.
    """
    from PIL import Image, UnidentifiedImageError

    known, key = current(), sha256(data).digest()
    if key in known.pictures:
        return known.pictures[key]
    try:
        with open_image(io.BytesIO(data)) as image:
            known.require_room(*image.size, name)
            pixels = _pixels(image)
    except Image.DecompressionBombError:
        raise AssetError(f"the texture {name} has too many pixels. Scale it down to 8192 × 8192.") from None
    except (UnidentifiedImageError, OSError, SyntaxError, ValueError, EOFError, struct.error) as error:
        raise AssetError(
            f"the texture {name} cannot be decoded ({error}). Open it in an image editor and save it as PNG or JPEG."
        ) from error
    pixels.setflags(write=False)
    known.pictures[key] = pixels
    return pixels


def _pixels(image: Image) -> np.ndarray:
    if image.mode.startswith("I"):  # 16 bits: Pillow would clip instead of scale
        deep = np.asarray(image)
        grey = np.empty(deep.shape, np.uint8)
        for top in range(0, len(deep), _ROWS):
            grey[top : top + _ROWS] = deep[top : top + _ROWS].clip(0, 65535) // 257
        return np.broadcast_to(grey[:, :, None], (*grey.shape, 3))
    if image.mode == "P":
        image = image.convert("RGBA")
    return np.asarray(image.convert("RGB"))


def open_image(file: IO[bytes]) -> ImageFile:
    """Any picture but those that Pillow hands to other programs; it is not decoded yet.

    Raises:
        PIL.Image.DecompressionBombError, PIL.UnidentifiedImageError, OSError, SyntaxError, ValueError: it cannot be.
    """
    from PIL import Image

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of its limit, which is ours or below; and of what is odd in a file
        return Image.open(file, formats=_KINDS)

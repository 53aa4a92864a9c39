"""STL, text and binary, with the colours that some programs hide in it."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from genmf_mi.assets.albedo import Material
from genmf_mi.assets.part import Part
from genmf_mi.core import colour
from genmf_mi.core.errors import AssetError

_FACE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_HEADER = 84
_VERTEX = re.compile(rb"\bvertex\s+(\S+)\s+(\S+)\s+(\S+)", re.IGNORECASE)


def read(path: Path) -> list[Part]:
    """All solids of a file as one part.

    Colours are those of Materialise Magics (``COLOR=`` in the header) and of VisCAM and SolidView, 15 bits per face,
    taken as sRGB-encoded.

    Raises:
        AssetError: the file is truncated, or no STL file.
    """
    data = path.read_bytes()
    count = int.from_bytes(data[_HEADER - 4 : _HEADER], "little")
    if len(data) >= _HEADER and len(data) == _HEADER + count * _FACE.itemsize:
        faces = np.frombuffer(data, _FACE, count, _HEADER)
        return [_part(faces["corners"].astype(np.float64), _colours(data[:80], faces["attribute"]))]
    if not data.lstrip()[:5].lower() == b"solid":
        raise AssetError(f"{path} is truncated, or not an STL file. Download or export it again.")
    try:
        corners = np.array(_VERTEX.findall(data), dtype="S32").astype(np.float64)
    except ValueError:
        raise AssetError(f"{path} has vertices that are not numbers. Export it again.") from None
    if len(corners) % 3 or not re.search(rb"\bendsolid\b", data[-4096:], re.IGNORECASE):
        raise AssetError(f"{path} is truncated: its last triangle or solid has no end. Download or export it again.")
    return [_part(corners.reshape(-1, 3, 3), None)]


def _part(corners: np.ndarray, colours: np.ndarray | None) -> Part:
    """Triangles ``[F,3,3]`` as a part; colours: linear, ``[F,3]``."""
    faces = np.arange(3 * len(corners)).reshape(-1, 3)
    rgb = None if colours is None else np.repeat(colours, 3, axis=0)
    return Part(corners.reshape(-1, 3), faces, Material(), colours=rgb)


def _colours(header: bytes, attribute: np.ndarray) -> np.ndarray | None:
    """Linear colours ``[F,3]``, or None where the attributes hold none."""
    own = attribute >> 15 == 1
    fields = np.stack([attribute >> shift & 31 for shift in (10, 5, 0)], axis=1)
    fallback = np.array([255, 255, 255], dtype=np.uint8)
    if (at := header.find(b"COLOR=")) >= 0:
        # Magics: red comes lowest, and the highest bit says that the colour of the whole part holds
        own, fields = ~own, fields[:, ::-1]
        if at + 10 <= len(header):
            fallback = np.frombuffer(header, np.uint8, 3, at + 6)
    elif not own.any():
        return None
    rgb = np.where(own[:, None], np.round(fields * (255 / 31)), fallback).astype(np.uint8)
    return colour.bytes_to_linear(rgb) if len(np.unique(rgb, axis=0)) > 1 else None

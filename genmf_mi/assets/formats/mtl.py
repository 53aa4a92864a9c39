"""Material libraries of Wavefront OBJ files."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from genmf_mi.assets.albedo import CLAMP, REPEAT, Material, Texture
from genmf_mi.assets.formats import beside
from genmf_mi.assets.part import decode_image
from genmf_mi.core import colour
from genmf_mi.core.errors import AssetError

_ARGUMENTS = {
    "-o": 3, "-s": 3, "-t": 3, "-mm": 2, "-blendu": 1, "-blendv": 1, "-cc": 1, "-clamp": 1, "-texres": 1, "-bm": 1,
    "-imfchan": 1, "-type": 1,
}  # fmt: skip


def decoded(data: bytes) -> str:
    """Text of a file whose encoding nobody wrote down."""
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return data.decode("utf-16", errors="replace")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def statement(line: str) -> tuple[str, str]:
    """Keyword in small letters and the rest of a line, which any blanks may part."""
    key, *rest = line.strip().split(maxsplit=1) or [""]
    return key.lower(), rest[0].strip() if rest else ""


def name_of(text: str) -> str:
    """A material's name as both files mean it: without quotes, and with single blanks."""
    return " ".join(text.strip().strip('"').split())


def libraries(obj: Path, names: str) -> dict[str, Material]:
    """The materials of an ``mtllib`` line, which may name several files.

    Raises:
        AssetError: one of them is missing, or a texture is.
    """
    whole = beside.find(obj, names)
    chosen = [names] if whole else _separate(names)
    materials: dict[str, Material] = {}
    for name in chosen:
        path = beside.find(obj, name)
        if path is None:
            raise AssetError(
                f"{obj} refers to the materials {name}, which are not beside it. "
                "Put that file there, or delete the mtllib line."
            )
        materials |= _library(obj, path)
    return materials


def _separate(names: str) -> list[str]:
    """Names that blanks part, quoted ones whole."""
    found = [quoted or plain for quoted, plain in re.findall(r'"([^"]+)"|(\S+)', names)]
    return found if len(found) > 1 and all(name.lower().endswith(".mtl") for name in found) else [names]


def _library(obj: Path, path: Path) -> dict[str, Material]:
    materials: dict[str, Material] = {}
    name = None
    for line in decoded(path.read_bytes()).splitlines():
        key, rest = statement(line)
        if key == "newmtl":
            name = name_of(rest)
            materials[name] = Material()
        elif key == "kd" and name is not None and materials[name].texture is None:
            materials[name] = Material(_diffuse(path, rest))
        elif key == "map_kd" and name is not None:
            materials[name] = Material(texture=_texture(obj, path.parent, rest))
    return materials


def _diffuse(path: Path, text: str) -> tuple[float, float, float]:
    numbers = text.split("#")[0].split()
    if numbers and numbers[0] in ("spectral", "xyz"):
        raise AssetError(f"{path} gives Kd as {numbers[0]}. Write it as three RGB numbers.")
    try:
        rgb = np.array((numbers * 3)[:3] if len(numbers) == 1 else numbers[:3], dtype=np.float64)
    except ValueError:
        rgb = np.full(3, np.nan)
    if rgb.shape != (3,) or not np.isfinite(rgb).all():
        raise AssetError(f"{path} has a Kd that is not three numbers: {text!r}. Correct it, or export it again.")
    red, green, blue = map(float, colour.to_linear(np.clip(rgb, 0, 1)))
    return red, green, blue


def _texture(obj: Path, folder: Path, text: str) -> Texture:
    """A ``map_Kd`` statement: options, then a file name that may hold blanks."""
    wrap, scale, offset = REPEAT, np.ones(3), np.zeros(3)
    rest = text
    while (head := rest.split(maxsplit=1)) and head[0].lower() in _ARGUMENTS and len(head) > 1:
        option, rest = head[0].lower(), head[1]
        values: list[str] = []
        while len(values) < _ARGUMENTS[option] and len(words := rest.split(maxsplit=1)) > 1:
            if values and not _is_number(words[0]):
                break
            values.append(words[0])
            rest = words[1]
        if option == "-clamp" and values[:1] == ["on"]:
            wrap = CLAMP
        elif option in ("-s", "-o") and all(map(_is_number, values)):
            target = scale if option == "-s" else offset
            target[: len(values)] = np.array(values, dtype=np.float64)
    data = beside.read(obj, rest, folder)
    if data is None:
        raise AssetError(f"{obj} uses the texture {rest}, which is not beside it. Put it there, or correct map_Kd.")
    # OBJ's v points up and the options act there, v' = s·v + o; ours points down: 1 - v' = s·(1 - v) + o.
    transform = np.array([[scale[0], 0, offset[0]], [0, scale[1], 1 - scale[1] - offset[1]]])
    return Texture(decode_image(data, rest), (wrap, wrap), transform=transform)


def _is_number(word: str) -> bool:
    try:
        return bool(np.isfinite(float(word)))
    except ValueError:
        return False

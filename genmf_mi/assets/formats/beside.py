"""Files that an asset names: textures, material libraries, buffers. They lie beside it, or it is refused.

An asset may come from anywhere. What it names is therefore looked for below its own folder only, unless the user has
allowed other places, must be a regular file of a sensible size, and is found in spite of how exporters write names:
with backslashes, quotes, absolute paths of the machine that made it, or another case of letters.
"""

from __future__ import annotations

import os
import stat
import unicodedata
from contextlib import suppress
from pathlib import Path, PureWindowsPath

from genmf_mi.assets.reading import current
from genmf_mi.core.errors import AssetError

LARGEST_FILE = 2 * 1024**3
"""Bytes of a file that an asset names."""


def find(asset: Path, name: str, folder: Path | None = None) -> Path | None:
    """The file that ``asset`` calls ``name``, or None if there is none.

    folder: that the name is relative to, if not that of the asset.

    Raises:
        AssetError: it lies outside the folder of the asset and is not allowed to, is no regular file, or is too large.
    """
    home = asset.parent.resolve()
    name = name.strip().strip("\"'").strip()
    if not name or "\0" in name:
        return None
    windows = PureWindowsPath(name)  # knows either slash
    relative = Path(*(part for part in windows.parts if part != windows.anchor))
    wanted = ([] if windows.is_absolute() or windows.root else [relative]) + [Path(relative.name)]
    for place in (folder or asset.parent, asset.parent):
        for candidate in (Path(spelled) for each in wanted for spelled in _spellings(str(each))):
            found = _in_any_case(place, candidate)
            if found is not None:
                return _safe(asset, home, name, found)
    outside = Path(name)
    if outside.is_absolute() and os.path.lexists(outside):
        return _safe(asset, home, name, outside)
    return None


def read(asset: Path, name: str, folder: Path | None = None) -> bytes | None:
    """The content of :func:`find`. Raises as it does, and for a file that cannot be read."""
    path = find(asset, name, folder)
    if path is None:
        return None
    try:
        return path.read_bytes()
    except OSError as error:
        raise AssetError(f"{asset} uses {name}, which cannot be read: {error.strerror}.") from error


def _spellings(name: str) -> list[str]:
    """The same name as systems write accents: composed, decomposed (macOS), and in Latin-1 (old archives)."""
    spelled = [name, *(unicodedata.normalize(form, name) for form in ("NFC", "NFD"))]
    with suppress(UnicodeEncodeError):
        spelled.append(os.fsdecode(spelled[1].encode("latin-1")))
    return list(dict.fromkeys(spelled))


def _in_any_case(folder: Path, relative: Path) -> Path | None:
    """``relative`` below ``folder``, its parts in any case of letters."""
    place = folder
    for part in relative.parts:
        following = place / part
        if part != ".." and not os.path.lexists(following):
            try:
                names = [entry.name for entry in place.iterdir() if entry.name.lower() == part.lower()]
            except OSError:
                return None
            if not names:
                return None
            following = place / sorted(names)[0]
        place = following
    return place if os.path.lexists(place) else None


def _safe(asset: Path, home: Path, name: str, path: Path) -> Path:
    try:
        real = path.resolve(strict=True)
        status = real.stat()
    except OSError as error:
        raise AssetError(f"{asset} uses {name}, which cannot be read: {error.strerror}.") from error
    if not (current().anywhere or real.is_relative_to(home)):
        raise _outside(asset, name)
    if not stat.S_ISREG(status.st_mode):
        raise AssetError(f"{asset} uses {name}, which is no file.")
    if status.st_size > LARGEST_FILE:
        raise AssetError(f"{asset} uses {name}, which is larger than {LARGEST_FILE / 1024**3:.0f} GB.")
    return real


def _outside(asset: Path, name: str) -> AssetError:
    return AssetError(
        f"{asset} names {name}, which is not below its own folder. If you trust it, copy it there, "
        "or use --files-anywhere."
    )

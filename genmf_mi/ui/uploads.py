"""Files in: names made harmless, sizes limited before anything is written, archives unpacked with both in mind."""

from __future__ import annotations

import re
import unicodedata
import zipfile
from collections.abc import AsyncIterator
from pathlib import Path, PurePosixPath

from genmf_mi.assets.suffixes import MESHES
from genmf_mi.core.errors import AssetError, OutputError

MAX_BYTES = 256 * 1024**2
"""Of an upload."""
MAX_UNPACKED, MAX_MEMBERS, MAX_RATIO = 1024**3, 2000, 200
"""Of an archive: bytes in all, files, and how many times smaller a file larger than a megabyte may be packed."""
MAX_NAME = 120
_HIDDEN = ("Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp")
"""Categories of characters that are not seen, or turn the direction of writing."""


class TooLargeError(AssetError):
    """An upload or what is in it is larger than permitted."""


def safe_name(name: str, fallback: str = "model") -> str:
    """The last part of a path, without characters that mean something to a file system, a page or a terminal."""
    last = unicodedata.normalize("NFC", name).replace("\\", "/").rpartition("/")[2]
    kept = "".join("_" if c in '<>:"|?*' or unicodedata.category(c) in _HIDDEN else c for c in last)
    kept = kept.rstrip(" .").lstrip(" -")
    stem, dot, suffix = kept.rpartition(".")
    if not dot:
        stem, suffix = kept, ""
    return (stem.strip(" .")[:MAX_NAME] or fallback) + (dot + suffix[:12] if dot else "")


def too_large() -> TooLargeError:
    """The error for an upload over :data:`MAX_BYTES`."""
    return TooLargeError(
        f"the file is larger than {MAX_BYTES // 1024**2} MB. Export it with smaller textures or fewer triangles: more "
        "than a million does not show on a print."
    )


async def receive(chunks: AsyncIterator[bytes], path: Path) -> None:
    """Write an upload piece by piece, so that it is never in memory as a whole.

    Raises:
        TooLargeError: it is larger than :data:`MAX_BYTES`.
        AssetError: it is empty.
        OutputError: it cannot be written.
    """
    size = 0
    try:
        with path.open("wb") as file:
            async for chunk in chunks:
                size += len(chunk)
                if size > MAX_BYTES:
                    raise too_large()
                file.write(chunk)
    except OSError as error:
        raise OutputError(f"the upload cannot be stored: {error.strerror}. Free some space.") from error
    if not size:
        raise AssetError("the file is empty. Download or export it again.")


def unpack(archive: Path, folder: Path) -> None:
    """Unpack a zip into ``folder``, whose names stay below it and whose sizes are known before the first byte.

    Raises:
        TooLargeError: what is in it is too large, or far larger than it claims.
        AssetError: it is damaged, encrypted, or names files outside.
    """
    try:
        with zipfile.ZipFile(archive) as opened:
            members = [each for each in opened.infolist() if not each.is_dir() and not _is_litter(each.filename)]
            _require_modest(members)
            for member in members:
                target = folder.joinpath(*_parts(member))
                target.parent.mkdir(parents=True, exist_ok=True)
                with opened.open(member) as source, target.open("xb") as file:
                    _copy(source, file, member.file_size)
    except (zipfile.BadZipFile, zipfile.LargeZipFile, RuntimeError, NotImplementedError, EOFError, ValueError) as error:
        raise AssetError(f"the zip cannot be read ({error}). Pack it again, without a password.") from error
    except FileExistsError as error:
        raise AssetError("the zip holds two files of one name. Pack it again.") from error
    except OSError as error:
        raise OutputError(f"the zip cannot be unpacked: {error.strerror}. Free some space.") from error


def find_model(folder: Path) -> Path:
    """The one model among the files of a folder, of the kind that says most about colours.

    Raises:
        AssetError: there is none, or there are several of that kind.
    """
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    for suffix in MESHES:
        found = [path for path in files if path.suffix.lower() == suffix]
        if len(found) == 1:
            return found[0]
        if found:
            names = ", ".join(path.name for path in found[:4])
            raise AssetError(f"there are several models: {names}. Choose one of them, with its textures.")
    suffixes = ", ".join(suffix[1:].upper() for suffix in MESHES)
    raise AssetError(f"there is no model among the files. Give one of {suffixes}, or a zip with one and its textures.")


def _require_modest(members: list[zipfile.ZipInfo]) -> None:
    if len(members) > MAX_MEMBERS:
        raise TooLargeError(f"the zip holds {len(members)} files; a model and its textures need far fewer.")
    bomb = any(each.file_size > 2**20 and each.file_size > MAX_RATIO * each.compress_size for each in members)
    if bomb or sum(each.file_size for each in members) > MAX_UNPACKED:
        raise TooLargeError("the zip is too large when unpacked. Pack only the model and its textures.")


def _copy(source, file, size: int) -> None:
    """Copy ``size`` bytes, which the archive has promised."""
    left = size
    while chunk := source.read(1 << 20):
        left -= len(chunk)
        if left < 0:
            raise TooLargeError("the zip holds more than it says. Pack it again.")
        file.write(chunk)


def _is_litter(name: str) -> bool:
    """Whether a file is what operating systems put into archives."""
    parts = PurePosixPath(name.replace("\\", "/")).parts
    return any(part == "__MACOSX" or (part.startswith(".") and part.strip(".") != "") for part in parts)


def _parts(member: zipfile.ZipInfo) -> list[str]:
    """The places of a file below the folder. Links are refused, as are names that lead outside."""
    name = member.filename.replace("\\", "/")
    parts = PurePosixPath(name).parts
    is_link = (member.external_attr >> 16) & 0o170000 == 0o120000
    if is_link or name.startswith("/") or ".." in parts or re.match(r"[A-Za-z]:", name):
        raise AssetError("the zip holds names that lead out of it. Pack it again.")
    return [safe_name(part) for part in parts]

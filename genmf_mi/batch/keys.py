"""When work is the same: hashes of content and settings, and cheap tokens that change when these may have changed."""

from __future__ import annotations

import hashlib
import json
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote

from genmf_mi.assets import samples
from genmf_mi.assets.formats import beside
from genmf_mi.assets.reading import reading
from genmf_mi.batch import storage
from genmf_mi.batch.work import Work
from genmf_mi.core.errors import AssetError, GenmfError

if TYPE_CHECKING:
    from genmf_mi.assets.asset import Asset
    from genmf_mi.assets.sdf_asset import SdfAsset

_NAMED = {
    ".gltf": re.compile(rb'"uri"\s*:\s*"((?!data:)[^"]+)"'),
    ".obj": re.compile(rb"^\s*mtllib\s+(.+?)\s*$", re.M | re.I),
    ".mtl": re.compile(rb"^\s*map_kd\s+(?:-\S+\s+(?:[-+.\d]+\s+)*)*(.+?)\s*$", re.M | re.I),
    ".ply": re.compile(rb"^comment TextureFile\s+(.+?)\s*$", re.M),
}
"""Where a file names others that it needs."""
HEADER = 1 << 16
"""Bytes at the start of a PLY or OBJ file, which may be large, in which it names others."""


def is_sample(asset: str) -> bool:
    """Whether a text names a bundled sample, and no file."""
    return asset.removesuffix(samples.SDF_SUFFIX) in samples.NAMES and not Path(asset).exists()


def named_files(path: Path) -> list[str]:
    """The names of further files that ``path`` needs, as it spells them."""
    pattern = _NAMED.get(path.suffix.lower())
    if pattern is None or not path.is_file():
        return []
    with path.open("rb") as file:
        content = file.read(HEADER if path.suffix.lower() in (".ply", ".obj") else -1)
    names = {match.decode("utf-8", errors="replace").strip('"') for match in pattern.findall(content)}
    return sorted(unquote(name) if path.suffix.lower() == ".gltf" else name for name in names)


def companions(path: Path) -> list[Path]:
    """The files that belong to an asset besides its own: buffers, materials, textures, wherever they are; those that
    are missing or not allowed are missed when it is read."""
    found: list[Path] = []
    with reading(anywhere=True):
        for name in named_files(path):
            try:
                other = beside.find(path, name)
            except GenmfError:  # no regular file, or too large
                continue
            if other is not None:
                found.append(other)
    return [file for one in found for file in (one, *companions(one))]


def token(asset: str | Asset | SdfAsset, work: Work) -> str:
    """Changes when an asset, what belongs to it, or ``work`` does; empty if a file is missing.

    Raises:
        UrlError: a store does not answer.
    """
    if not isinstance(asset, str):
        return key(asset, work)
    versions: list[str] = []
    for place in (asset, *_files(work)):
        if is_sample(place):
            continue
        current = storage.version(place)
        if current is None:
            return ""
        versions.append(current)
        if not storage.is_url(place):
            versions += [str(storage.version(str(other))) for other in companions(storage.path_of(place))]
    return _hash([asset, versions, work.described()])


def key(asset: str | Asset | SdfAsset, work: Work) -> str:
    """A hash of the content of the asset, of the files that ``work`` names, and of all settings.

    The content behind a URL counts by what its store says of it, as it is not fetched for this.

    Raises:
        AssetError: a file is missing. UrlError: a store does not answer.
    """
    contents = [_content(place) for place in (asset, *_files(work))]
    described = {name: value for name, value in work.described().items() if name not in ("textured", "scene")}
    turns = [text.rpartition("@")[2] for text in work.references]
    return _hash([contents, {**described, "references": turns}, [work.textured is None, work.scene is None]])


def _files(work: Work) -> list[str]:
    """The files that a piece of work needs besides the asset."""
    pictures = [text.rpartition("@")[0] for text in work.references]
    return [place for place in (work.textured, work.scene, *pictures, *work.painted.values()) if place]


def _content(asset: str | Asset | SdfAsset) -> str:
    if not isinstance(asset, str):
        from genmf_mi.pipeline.run_folder import fingerprint

        return fingerprint(asset)
    if is_sample(asset):
        return asset
    if storage.is_url(asset):
        current = storage.version(asset)
        if current is None:
            raise AssetError(f"there is nothing at {asset}. Check the spelling.")
        return f"{asset} {current}"
    path = storage.path_of(asset)
    if not path.is_file():
        raise AssetError(f"there is no file {path}, and the bundled samples are {', '.join(samples.NAMES)}.")
    digest = hashlib.sha256(path.suffix.lower().encode())
    for file in (path, *companions(path)):
        with file.open("rb") as content:
            digest.update(hashlib.file_digest(content, "sha256").digest())
    return digest.hexdigest()


def _hash(value: Any) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True, default=str).encode()).hexdigest()[:32]

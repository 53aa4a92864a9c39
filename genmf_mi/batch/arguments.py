"""What the words of a command line mean as items of a batch."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

from genmf_mi.assets.suffixes import FIELDS, MESHES
from genmf_mi.batch import storage
from genmf_mi.batch.items import BatchItem, as_item
from genmf_mi.batch.manifest import read_manifest
from genmf_mi.core.errors import ConfigError

MANIFESTS = (".csv", ".jsonl")


def items_of(arguments: Iterable[str | Path]) -> list[BatchItem]:
    """The items that the words of a command line mean: files, URLs and names of samples; folders, for all assets in
    them and below; patterns with ``*``; manifests.

    Raises:
        ConfigError: nothing is meant, or a manifest is wrong.
    """
    items: list[BatchItem] = []
    for argument in map(str, arguments):
        suffix = Path(argument).suffix.lower()
        if suffix in MANIFESTS:
            items += read_manifest(argument)
        elif re.search(r"[*?\[]", argument) and not storage.path_of(argument).exists():
            items += [BatchItem(asset) for asset in _some(storage.matching(argument), f"no file fits {argument}.")]
        elif argument.endswith("/") or (not storage.is_url(argument) and storage.path_of(argument).is_dir()):
            items += _of_folder(argument)
        else:
            items.append(as_item(argument))
    if not items:
        raise ConfigError("name at least one asset, folder, pattern or manifest.")
    return items


def _of_folder(folder: str) -> list[BatchItem]:
    """All assets in a folder; their names are their paths in it."""
    suffixes = (*MESHES, *FIELDS)
    files = [file for file in storage.find(folder, "*", deep=True) if Path(file).suffix.lower() in suffixes]
    _some(files, f"{folder} holds no asset. It takes {', '.join(suffixes)}.")
    root = folder.rstrip("/") if storage.is_url(folder) else str(storage.path_of(folder))
    items: list[BatchItem] = []
    for file in files:
        inside = file.removeprefix(root).lstrip("/").replace("\\", "/")
        items.append(BatchItem(file, str(Path(inside).with_suffix("")).replace("/", "_")))
    return items


def _some(files: list[str], otherwise: str) -> list[str]:
    if not files:
        raise ConfigError(otherwise)
    return files

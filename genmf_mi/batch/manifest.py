"""Manifests: CSV with a header, or one JSON object a line; a line is an asset with settings of its own."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterator, Mapping
from typing import Any, cast

from genmf_mi.batch import storage
from genmf_mi.batch.items import BatchItem, from_folder_of
from genmf_mi.batch.work import FILES, setting_name
from genmf_mi.core.errors import ConfigError
from genmf_mi.core.regions import VERTEX_COLOURS

ASSET, NAME = "asset", "name"
"""Columns that are no settings."""


def read_manifest(place: str) -> list[BatchItem]:
    """The items of a manifest, a path or a URL. Its column ``asset`` is required, ``name`` names the run folder, all
    others are settings of ``genmf-mi refine``; empty cells leave a setting as it is. Relative paths are relative to the
    manifest.

    Raises:
        ConfigError: the file is missing or no manifest, a column is missing or unknown, a line has no asset or is
            given twice.
    """
    text = storage.read_text(place)
    if text is None:
        raise ConfigError(f"there is no manifest {place}. Check the spelling.")
    rows = _csv(place, text) if place.lower().endswith(".csv") else _jsonl(place, text)
    folder, items, seen = storage.split(place)[0], list[BatchItem](), dict[str, str]()
    for where, row in rows:
        item = _item(where, row, folder)
        same = json.dumps([str(item.asset), item.name, dict(item.settings)], sort_keys=True, default=str)
        if same in seen:
            raise ConfigError(f"{where} repeats {seen[same]}. Delete one.")
        seen[same] = where
        items.append(item)
    if not items:
        raise ConfigError(f"{place} holds no item.")
    return items


def _csv(place: str, text: str) -> Iterator[tuple[str, Mapping[str, Any]]]:
    reader = csv.reader(io.StringIO(text.removeprefix("\ufeff"), newline=""))
    try:
        header = [cell.strip() for cell in next(reader, [])]
        if ASSET not in header:
            found = ", ".join(header) or "nothing"
            raise ConfigError(f"{place} lacks the column {ASSET}: its first line has {found}.")
        names = [cell if cell in (ASSET, NAME) else _setting(place, cell) for cell in header]
        for cells in reader:
            if any(cell.strip() for cell in cells):
                where = f"{place}, line {reader.line_num}"
                if len(cells) > len(names):
                    raise ConfigError(f"{where} has {len(cells)} cells for {len(names)} columns. Put quotes around it.")
                yield where, {name: cell.strip() for name, cell in zip(names, cells, strict=False) if cell.strip()}
    except csv.Error as error:
        raise ConfigError(f"{place}, line {reader.line_num} is no CSV: {error}.") from error


def _jsonl(place: str, text: str) -> Iterator[tuple[str, Mapping[str, Any]]]:
    for number, line in enumerate(text.split("\n"), 1):
        if not line.strip():
            continue
        where = f"{place}, line {number}"
        try:
            row = json.loads(line)
        except (ValueError, RecursionError) as error:
            raise ConfigError(f"{where} is no JSON: {error}.") from error
        if not isinstance(row, dict):
            raise ConfigError(f'{where} is no object such as {{"asset": "bus.glb", "size_mm": 80}}.')
        values = cast(dict[str, Any], row)
        yield (
            where,
            {
                name if name in (ASSET, NAME) else _setting(where, name): value
                for name, value in values.items()
                if value is not None and value != ""
            },
        )


def _setting(where: str, name: str) -> str:
    try:
        return setting_name(name)
    except ConfigError as error:
        raise ConfigError(f"{where}: {error}") from None


def _item(where: str, row: Mapping[str, Any], folder: str) -> BatchItem:
    settings = dict(row)
    asset, name = settings.pop(ASSET, None), settings.pop(NAME, "")
    if not isinstance(asset, str):
        raise ConfigError(f"{where} lacks the {ASSET}: a file, a URL or the name of a sample.")
    for file in FILES:
        if isinstance(value := settings.get(file), str) and value != VERTEX_COLOURS:
            settings[file] = ";".join(from_folder_of(folder, part) for part in value.split(";"))
        elif isinstance(value, list):
            settings[file] = [from_folder_of(folder, str(part)) for part in cast(list[Any], value)]
    return BatchItem(from_folder_of(folder, asset), str(name), settings, where)

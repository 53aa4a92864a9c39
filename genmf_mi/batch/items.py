"""The items of a batch: from arguments, a folder, a pattern, a manifest, or objects in memory."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from genmf_mi.batch import storage
from genmf_mi.batch.keys import is_sample
from genmf_mi.core.errors import ConfigError

if TYPE_CHECKING:
    from genmf_mi.assets.asset import Asset
    from genmf_mi.assets.sdf_asset import SdfAsset


@dataclass(frozen=True)
class BatchItem:
    """One asset of a batch.

    asset: a file, a URL, the name of a bundled sample, or an asset in memory.
    name: of the item and of its run folder; that of the asset if empty.
    settings: by name, in place of those of the batch: what ``genmf-mi refine`` has as options, such as ``size_mm``.
    where: what to call the item in messages, such as the line of a manifest.
    """

    asset: str | Path | Asset | SdfAsset
    name: str = ""
    settings: Mapping[str, Any] = field(default_factory=dict[str, Any])
    where: str = ""

    @property
    def folder_name(self) -> str:
        """The name of the run folder."""
        if self.name:
            return self.name
        return stem(str(self.asset)) if isinstance(self.asset, str | Path) else self.asset.name

    def __str__(self) -> str:
        return self.where or str(self.asset if isinstance(self.asset, str | Path) else self.asset.name)


AnyItem: TypeAlias = "str | Path | Asset | SdfAsset | BatchItem"


def stem(place: str) -> str:
    """The name of a file without its suffix."""
    return Path(storage.split(place)[1]).stem


def as_item(item: AnyItem) -> BatchItem:
    """Paths become texts."""
    if not isinstance(item, BatchItem):
        item = BatchItem(item)
    if isinstance(item.asset, Path):
        item = BatchItem(str(item.asset), item.name, item.settings, item.where)
    if isinstance(item.asset, str) and item.asset.startswith("file://"):
        item = BatchItem(str(storage.path_of(item.asset)), item.name, item.settings, item.where)
    return item


def require_names(items: Sequence[BatchItem]) -> None:
    """Raise :class:`ConfigError` if two items would share a folder, or a name is no name of a folder."""
    seen: dict[str, BatchItem] = {}
    for item in items:
        name = item.folder_name
        require_name(item)
        if other := seen.get(name.casefold()):
            if item.where:
                raise ConfigError(
                    f"{item.where} and {other.where or other} have the same name {name!r}, and so would share a "
                    "folder. Give them a column name, or delete one."
                )
            raise ConfigError(
                f"two assets have the same file name, and so would share a folder: {other} and {item}. Rename one."
            )
        seen[name.casefold()] = item


def require_name(item: BatchItem) -> None:
    """Raise :class:`ConfigError` for a name that cannot be that of a folder."""
    name = item.folder_name
    if not name.strip() or name in (".", "..") or re.search(r'[/\\\0:*?"<>|\n]', name) or len(name.encode()) > 200:
        raise ConfigError(f"{item}: {name!r} cannot be the name of a folder. Use letters, digits, dots and dashes.")


def from_folder_of(folder: str, place: str) -> str:
    """A place that a manifest in ``folder`` names: relative to it, unless it says all of itself or is a sample."""
    if storage.is_url(place) or place.startswith("file://") or storage.path_of(place).is_absolute():
        return place
    beside = storage.join(folder, place)
    return place if is_sample(place) and not (not storage.is_url(folder) and Path(beside).exists()) else beside


def strided(items: Iterable[BatchItem], first: int, step: int) -> Iterator[BatchItem]:
    """Every ``step``-th item from the one at index ``first``."""
    for index, item in enumerate(items):
        if index % step == first:
            yield item

"""What is handed to a worker, and how much of the machine it may take."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from typing import TYPE_CHECKING

from genmf_mi.batch.journal import BatchOutcome
from genmf_mi.batch.work import Work
from genmf_mi.core.errors import ConfigError

if TYPE_CHECKING:
    from genmf_mi.assets.asset import Asset
    from genmf_mi.assets.sdf_asset import SdfAsset


@dataclass(frozen=True)
class Task:
    """One item, ready to be done anywhere.

    name: of the item. asset: a path, a URL, the name of a sample, or the asset itself.
    folder: of the run, a path or a URL. key, token: see :class:`genmf_mi.batch.journal.BatchOutcome`.
    force: replace what the folder holds. afresh: forget earlier crashes.
    """

    name: str
    asset: str | Asset | SdfAsset
    work: Work
    folder: str
    key: str = ""
    token: str = ""
    force: bool = False
    afresh: bool = False

    @property
    def asset_name(self) -> str:
        """The asset as a person would name it."""
        return self.asset if isinstance(self.asset, str) else self.asset.name

    def outcome(self, state: str, **values: object) -> BatchOutcome:
        """An outcome of this task."""
        named = {"name": self.name, "state": state, "asset": self.asset_name, "folder": self.folder}
        outcome = BatchOutcome.from_dict({**named, "key": self.key, "token": self.token, **values})
        assert outcome is not None
        return outcome


@dataclass(frozen=True)
class Limits:
    """What an item and a worker may take.

    seconds: of an item, from its first start to its end in one worker; 0 for no limit. memory_gb: of its worker; 0 for
        the share of the machine. crashes: of its worker, after which an item is quarantined.
    retries: after failures that may pass, such as a full disk or a network that does not answer.
    items, growth_mb: a worker is replaced after so many items, or when it has grown by so much since its first.
    """

    seconds: float = 4 * 3600.0
    memory_gb: float = 0.0
    crashes: int = 3
    retries: int = 1
    items: int = 100
    growth_mb: float = 1000.0

    def __post_init__(self) -> None:
        for name in ("seconds", "memory_gb", "growth_mb"):
            if not (isfinite(getattr(self, name)) and getattr(self, name) >= 0):
                raise ConfigError(f"the limit {name} cannot be {getattr(self, name)}: 0 sets none.")
        if self.crashes < 1 or self.retries < 0 or self.items < 1:
            raise ConfigError("crashes and items of a worker must be at least 1, and retries not negative.")

"""``item.json`` in the folder of a run: which work it is, and how often it was begun and died."""

from __future__ import annotations

import json
import os
import socket
from dataclasses import dataclass, field, fields, replace
from typing import Any, cast

from genmf_mi.batch import storage
from genmf_mi.batch.journal import now
from genmf_mi.batch.task import Task

FILE = "item.json"
LOST = 10
"""Beginnings without an end, as of machines that were switched off, after which an item is quarantined too."""


@dataclass(frozen=True)
class ItemRecord:
    """What is known of an item besides its run. Supervisor and worker write it in turn, so each reads it anew.

    key: of the work that the folder holds, empty if there is none. tried: of the work that was begun last; begun: how
    often; ended: starts that came to an end, good or bad; deaths: why workers died of it.
    """

    folder: str
    key: str = ""
    tried: str = ""
    begun: int = 0
    ended: int = 0
    deaths: tuple[str, ...] = ()
    work: dict[str, Any] = field(default_factory=dict[str, Any])

    @classmethod
    def load(cls, folder: str) -> ItemRecord:
        """What the folder holds; a new one if that is nothing, or damaged."""
        try:
            values = json.loads(storage.read_text(storage.join(folder, FILE)) or "{}")
            known = cast(dict[str, Any], values) if isinstance(values, dict) else {}
            return cls(
                folder, str(known.get("key", "")), str(known.get("tried", "")), int(known.get("begun", 0)),
                int(known.get("ended", 0)), tuple(map(str, known.get("deaths", ()))), dict(known.get("work", {})),
            )  # fmt: skip
        except (ValueError, TypeError, RecursionError):
            return cls(folder)

    @property
    def lost(self) -> int:
        """Starts of which nothing was heard again."""
        return max(0, self.begun - self.ended - len(self.deaths))

    def begin(self, task: Task) -> ItemRecord:
        """The work starts, once more unless it is another or earlier crashes are to be forgotten."""
        known = (
            self if self.tried == task.key and not task.afresh else ItemRecord(self.folder, self.key, work=self.work)
        )
        return replace(known, tried=task.key, begun=known.begun + 1)._saved()

    def claim(self, task: Task) -> ItemRecord:
        """The folder holds this work now."""
        return replace(self, key=task.key, work={"asset": task.asset_name, **task.work.described()})._saved()

    def died(self, cause: str) -> ItemRecord:
        """A worker died of it."""
        return replace(self, deaths=(*self.deaths, cause))._saved()

    def end(self) -> ItemRecord:
        """The work came to an end, with a part or an error."""
        return replace(self, ended=self.ended + 1)._saved()

    def _saved(self) -> ItemRecord:
        values = {one.name: getattr(self, one.name) for one in fields(self) if one.name != "folder"}
        storage.write_text(storage.join(self.folder, FILE), json.dumps({**values, "time": now()}, indent=1) + "\n")
        return self


def worker_name() -> str:
    """``host:process``."""
    return f"{socket.gethostname()}:{os.getpid()}"

"""The state of a batch on disk: one line per outcome, in a file that only ever grows.

``outcomes.jsonl`` in the output folder, or ``outcomes-3-of-64.jsonl`` of a shard. Each line is written by one call to a
file opened for appending and has reached the disk before the next item counts as done; a line that a killed process
has torn is passed over.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal, cast

from genmf_mi.batch import storage
from genmf_mi.core.errors import GenmfError, OutputError
from genmf_mi.core.files import lock

State = Literal["refined", "skipped", "duplicate", "failed", "quarantined"]
PATTERN, METRICS = "outcomes*.jsonl", "metrics.json"
"""Names of journals; and the file whose presence says that a run is complete."""
FINAL = ("asset", "solid", "optimisation")
"""Causes of failures that come again with the same asset and settings."""


@dataclass(frozen=True)
class BatchOutcome:
    """What became of one item.

    name: of the item, and of its run folder. state: ``refined``; ``skipped``, done before; ``duplicate``, the same
        work as the item ``of``; ``failed``; ``quarantined``, its worker died too often.
    asset: what was to be refined. folder: of the run, a path or a URL.
    key: a hash of the content of the asset and of all settings. token: a cheap stand-in for it, of size and time of
        the files.
    cause: of a failure, one word for what :class:`genmf_mi.core.errors.GenmfError` it was, or ``crash``, ``time``,
        ``memory``, ``url``, ``defect``. error: in a sentence. warnings: of the run.
    scores: the figures that the gallery shows. seconds: of wall time, cpu_seconds: of all threads.
    attempts: how often the item was started. worker: ``host:process``. ended: when, in ISO 8601, UTC.
    """

    name: str
    state: State
    asset: str = ""
    folder: str = ""
    key: str = ""
    token: str = ""
    of: str = ""
    cause: str = ""
    error: str = ""
    warnings: tuple[str, ...] = ()
    scores: dict[str, float] = field(default_factory=dict[str, float])
    seconds: float = 0.0
    cpu_seconds: float = 0.0
    peak_memory_gb: float = 0.0
    attempts: int = 0
    worker: str = ""
    ended: str = ""

    @property
    def complete(self) -> bool:
        """Whether its own folder holds the part."""
        return self.state in ("refined", "skipped")

    @property
    def good(self) -> bool:
        """Whether there is a part, or will be of the item that this one repeats."""
        return self.state not in ("failed", "quarantined")

    @property
    def final(self) -> bool:
        """Whether the same would come of it again."""
        return self.good or self.state == "quarantined" or self.cause in FINAL

    def metrics(self) -> dict[str, Any]:
        """The contents of ``metrics.json`` of the run. Raises :class:`OutputError` if there is none."""
        text = storage.read_text(storage.join(self.folder, METRICS))
        if text is None:
            raise OutputError(f"{self.folder} holds no metrics: {self.name} is {self.state}.")
        return cast(dict[str, Any], json.loads(text))

    def to_dict(self) -> dict[str, Any]:
        """What is not empty, as plain types."""
        values = {one.name: getattr(self, one.name) for one in fields(self)}
        return {name: list(value) if isinstance(value, tuple) else value for name, value in values.items() if value}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> BatchOutcome | None:
        """None for what is no outcome."""
        known = {one.name: values[one.name] for one in fields(cls) if one.name in values}
        if not (isinstance(known.get("name"), str) and isinstance(known.get("state"), str)):
            return None
        return cls(**{**known, "warnings": tuple(known.get("warnings", ()))})


def cause_of(error: GenmfError) -> str:
    """One word: ``asset`` for an :class:`genmf_mi.core.errors.AssetError`."""
    return type(error).__name__.removesuffix("Error").lower()


def now() -> str:
    """The time in ISO 8601, UTC."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")


class Journal:
    """The file of one shard, open for appending by one process at a time.

    Raises:
        OutputError: another process has it, or it cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._handle = path.open("ab", buffering=0)
        except OSError as error:
            raise OutputError(f"cannot write {path}: {error.strerror}. Choose another --out.") from error
        if not lock(self._handle):
            self._handle.close()
            raise OutputError(f"another batch is writing {path}. Wait for it, or choose another --out or --shard.")
        if _torn(path):
            self._handle.write(b"\n")

    def append(self, record: Mapping[str, Any]) -> None:
        """One line, on the disk when this returns. Raises :class:`OutputError`."""
        line = json.dumps(record).encode() + b"\n"
        try:
            if self._handle.write(line) != len(line):
                raise OSError(28, "No space left on device")
            os.fsync(self._handle.fileno())
        except OSError as error:
            raise OutputError(
                f"cannot write {self.path}: {error.strerror}. Free some space and start the batch again: it goes on."
            ) from error

    def close(self) -> None:
        self._handle.close()


def _torn(path: Path) -> bool:
    """Whether the last line has no end."""
    with path.open("rb") as file:
        if file.seek(0, os.SEEK_END) == 0:
            return False
        file.seek(-1, os.SEEK_END)
        return file.read(1) != b"\n"


def lines(text: str) -> list[dict[str, Any]]:
    """The records in the text of a journal; what is no record, as a torn line, is left out."""
    records: list[dict[str, Any]] = []
    for line in text.split("\n"):
        try:
            record = json.loads(line) if line.strip() else None
        except (ValueError, RecursionError):
            continue
        if isinstance(record, dict):
            records.append(cast(dict[str, Any], record))
    return records


def latest(records: Iterable[Mapping[str, Any]]) -> dict[str, BatchOutcome]:
    """The last outcome of every item by its name, whichever shard wrote it."""
    found: dict[str, BatchOutcome] = {}
    for record in records:
        outcome = BatchOutcome.from_dict(record)
        if outcome is None:
            continue
        before = found.get(outcome.name)
        if before is None or before.ended <= outcome.ended:
            found[outcome.name] = outcome
    return found


def read(out: str) -> list[dict[str, Any]]:
    """All records of all shards in the output folder, a path or a URL."""
    records: list[dict[str, Any]] = []
    for place in storage.find(out, PATTERN):
        records += lines(storage.read_text(place) or "")
    return records

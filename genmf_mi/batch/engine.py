"""The loop of a batch: what is left to do goes to an executor, what comes of it goes to the journal and the caller."""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from genmf_mi.batch import storage
from genmf_mi.batch.executors import Executor, InProcess, LocalExecutor
from genmf_mi.batch.items import AnyItem, BatchItem, as_item, require_name, require_names, strided
from genmf_mi.batch.journal import METRICS, BatchOutcome, Journal, cause_of, latest, lines, now, read
from genmf_mi.batch.keys import key, token
from genmf_mi.batch.shards import Shard, shard_of
from genmf_mi.batch.task import Limits, Task
from genmf_mi.batch.work import Work, with_settings
from genmf_mi.core.config import RefineConfig
from genmf_mi.core.errors import ConfigError, GenmfError
from genmf_mi.core.progress import Progress

REGIONS_SUFFIX = ".regions.json"
"""In place of an asset's suffix: what was painted on it."""
UPLOAD_EVERY = 30.0
"""Seconds between two uploads of the journal, for an output folder behind a URL."""


def run_batch(
    items: Iterable[AnyItem],
    config: RefineConfig | None = None,
    *,
    out: str | Path = "runs",
    executor: Literal["local", "ray", "inline"] | Executor = "local",
    workers: int = 0,
    threads: int = 0,
    address: str = "auto",
    shard: str | Shard = "",
    limits: Limits | None = None,
    force: bool = False,
    retry_failed: bool = False,
    progress: Progress | None = None,
    **options: Any,
) -> Iterator[BatchOutcome]:
    """Refine many assets, and yield what became of each as it comes. Call it again to go on after an interruption.

    Args:
        items: files, URLs, names of bundled samples, assets in memory, or :class:`genmf_mi.BatchItem` with settings of
            their own. A list is checked before the work begins; of an iterator, items are taken as there is room.
        config: the settings of items that have no others.
        out: folder for the runs, one subfolder per item, and for the journal; a path or a URL.
        executor: ``local``, worker processes on this machine; ``ray``, tasks on a Ray cluster at ``address``;
            ``inline``, this process; or an object of one's own.
        workers: 0 for as many as memory and cores hold. threads: of each worker, 0 to share the cores out.
        shard: ``3/64`` for the third of 64 parts, ``auto`` in a job array of Slurm or AWS Batch.
        limits: of time, memory and crashes. force: replace runs in ``out``. retry_failed: try quarantined items, and
            those that failed by themselves, again.
        options: ``textured``, ``up``, ``files_anywhere``, ``scene``, ``references``, ``verify``, ``print_check``,
            ``slicer``, ``save_exr`` as for :func:`genmf_mi.refine`.

    Raises:
        ConfigError: two items of one name, a setting that does not exist, no such shard. OutputError: another batch
            writes the same journal. SetupError: no cluster, or a package is missing. Later on, what is wrong with an
            item is an outcome with ``state="failed"``.
    """
    work = _work(config or RefineConfig(), options)
    part = shard if isinstance(shard, Shard) else shard_of(shard)
    limits = limits or Limits()
    if isinstance(items, Sequence) and not isinstance(items, str | bytes):
        items = [as_item(item) for item in items]
        require_names(items)
        for item in items:
            work_of(item, work)
        total = len(range(part.number - 1, len(items), part.count))
    else:
        total = None
    batch = Batch(str(storage.path_of(str(out))) if not storage.is_url(str(out)) else str(out), work, part,
                  force=force, retry_failed=retry_failed, total=total)  # fmt: skip
    engine = _executor(executor, work.config, limits, workers, threads, address)
    try:
        batch.open()
    except BaseException:
        engine.close()
        raise
    return batch.outcomes((as_item(item) for item in items), engine, progress or Progress())


def _work(config: RefineConfig, options: Mapping[str, Any]) -> Work:
    names = {name for name in Work.__dataclass_fields__ if name != "config"}
    if unknown := sorted(set(options) - names):
        raise ConfigError(f"there is no option {unknown[0]!r}: {', '.join(sorted(names))} can be given.")
    values: dict[str, Any] = {name: str(one) if isinstance(one, Path) else one for name, one in options.items()}
    if "references" in values:
        values["references"] = tuple(values["references"])
    if isinstance(slicer := values.get("print_check"), str):
        values |= {"print_check": True, "slicer": slicer}
    return Work(config, **values)


def work_of(item: BatchItem, work: Work) -> Work:
    """``work`` with the settings of the item, and with the strokes in NAME.regions.json beside its asset unless others
    are named. Raises :class:`ConfigError` that names the item."""
    try:
        own = with_settings(work, item.settings) if item.settings else work
    except ConfigError as error:
        raise ConfigError(f"{item}: {error}") from None
    if own.config.regions is None and isinstance(item.asset, str | Path) and not storage.is_url(str(item.asset)):
        painted = storage.path_of(str(item.asset)).with_suffix(REGIONS_SUFFIX)
        if painted.is_file():
            return replace(own, config=replace(own.config, regions=str(painted)))
    return own


def _executor(
    executor: str | Executor, config: RefineConfig, limits: Limits, workers: int, threads: int, address: str
) -> Executor:
    if not isinstance(executor, str):
        return executor
    if executor == "local":
        return LocalExecutor(workers, threads, limits, config)
    if executor == "inline":
        return InProcess()
    if executor == "ray":
        from genmf_mi.batch.ray_executor import RayExecutor

        return RayExecutor(address, threads, limits, config)
    raise ConfigError(f"there is no executor {executor!r}: choose local, ray or inline.")


@dataclass
class Batch:
    """One shard of a batch and what is known of it.

    out: a path or a URL. total: items of this shard, None if that is not known beforehand.
    """

    out: str
    work: Work
    shard: Shard
    force: bool = False
    retry_failed: bool = False
    total: int | None = None
    counts: dict[str, int] = field(default_factory=dict[str, int])

    def open(self) -> None:
        """Read what is known and open the journal. Raises :class:`OutputError`."""
        self.known = latest(read(self.out))
        # What was refined, by its key, so that the same work is not done under another name
        done = [one for one in self.known.values() if one.complete and one.key and not self.force]
        self.owners = {one.key: one.name for one in done}
        self.journal = Journal(self._journal_path())
        self.journal.append({"batch": str(self.shard), "items": self.total, "time": now()})
        self._uploaded = time.monotonic()

    def outcomes(self, items: Iterator[BatchItem], executor: Executor, progress: Progress) -> Iterator[BatchOutcome]:
        """See :func:`run_batch`."""
        ready: deque[BatchOutcome] = deque()
        tasks = self._tasks(strided(items, self.shard.number - 1, self.shard.count), ready)
        pace = Pace()
        progress.stage("batch" if self.shard.count == 1 else f"shard {self.shard}")
        running = executor.run(tasks)
        try:
            for outcome in running:
                if outcome is not None:
                    ready.append(self._recorded(outcome))
                while ready:
                    yield self._counted(ready.popleft(), pace)
                self._report(executor, progress, pace)
            while ready:
                yield self._counted(ready.popleft(), pace)
        finally:
            executor.close()
            if close := getattr(running, "close", None):
                close()
            self._upload()
            self.journal.close()

    def _tasks(self, items: Iterator[BatchItem], ready: deque[BatchOutcome]) -> Iterator[Task]:
        """What is left to do; what is not goes to ``ready``."""
        names: set[str] = set()
        for item in items:
            name = item.folder_name
            blank = Task(name, item.asset if not isinstance(item.asset, Path) else str(item.asset), self.work,
                         storage.join(self.out, name))  # fmt: skip
            try:
                require_name(item)
                if self.total is None and name.casefold() in names:
                    raise ConfigError(f"another item has the name {name!r} too. Give each a name of its own.")
                names.add(name.casefold())
                task, outcome = self._prepared(item, replace(blank, work=work_of(item, self.work)))
            except GenmfError as error:
                failed = blank.outcome("failed", cause=cause_of(error), error=str(error))
                task, outcome = None, self._recorded(failed)
            if outcome is not None:
                ready.append(outcome)
            if task is not None:
                yield task

    def _prepared(self, item: BatchItem, task: Task) -> tuple[Task | None, BatchOutcome | None]:
        """The task to do, or the outcome if there is nothing to do."""
        before = self.known.get(task.name)
        current = token(task.asset, task.work)
        if before is not None and before.token != current:
            before = None
        if current and before is not None and not self.force:
            if before.complete and self._there(before):
                return None, replace(before, state="skipped")
            if not before.good and before.final and not self.retry_failed:
                return None, before
        task = replace(
            task, key=before.key if before is not None and before.key else key(task.asset, task.work), token=current,
            force=self.force, afresh=self.retry_failed or self.force,
        )  # fmt: skip
        owner = self.owners.setdefault(task.key, task.name)
        if owner != task.name:
            return None, self._recorded(task.outcome("duplicate", of=owner))
        return task, None

    def _there(self, outcome: BatchOutcome) -> bool:
        """Whether the run is still where it was; behind a URL that is taken for granted, as asking is slow."""
        return storage.is_url(outcome.folder) or storage.exists(storage.join(outcome.folder, METRICS))

    def _recorded(self, outcome: BatchOutcome) -> BatchOutcome:
        """The outcome with its time, once it is in the journal."""
        outcome = replace(outcome, ended=now())
        self.journal.append(outcome.to_dict())
        if not outcome.good and self.owners.get(outcome.key) == outcome.name:
            del self.owners[outcome.key]
        if time.monotonic() - self._uploaded > UPLOAD_EVERY:
            self._upload()
        return outcome

    def _counted(self, outcome: BatchOutcome, pace: Pace) -> BatchOutcome:
        self.counts[outcome.state] = self.counts.get(outcome.state, 0) + 1
        pace.count(outcome)
        return outcome

    def _report(self, executor: Executor, progress: Progress, pace: Pace) -> None:
        done = sum(self.counts.values())
        bad = self.counts.get("failed", 0) + self.counts.get("quarantined", 0)
        figures = {"failed": bad, "per hour": round(pace.per_hour, 1), "GB": round(executor.memory_gb(), 1)}
        progress.advance(done, max(self.total or 0, done, 1), figures)

    def _journal_path(self) -> Path:
        """On disk; for an output folder behind a URL, in the cache, with what the URL has of it."""
        if not storage.is_url(self.out):
            return Path(self.out) / self.shard.file
        cache = Path(os.environ.get("GENMF_CACHE") or "~/.cache/genmf_mi").expanduser()
        path = cache / "batch" / hashlib.sha256(self.out.encode()).hexdigest()[:16] / self.shard.file
        there = storage.read_text(storage.join(self.out, self.shard.file)) or ""
        here = storage.read_text(str(path)) or ""
        path.parent.mkdir(parents=True, exist_ok=True)
        if missing := [line for line in lines(there) if line not in lines(here)]:
            with path.open("a", encoding="utf-8") as file:
                file.write("".join(json.dumps(line) + "\n" for line in missing))
        self.known |= latest(lines(here))
        return path

    def _upload(self) -> None:
        if storage.is_url(self.out):
            storage.upload(self.journal.path, storage.join(self.out, self.shard.file))
        self._uploaded = time.monotonic()


class Pace:
    """How many items an hour are refined since the first began."""

    def __init__(self) -> None:
        self._start, self._done = time.monotonic(), 0

    def count(self, outcome: BatchOutcome) -> None:
        self._done += outcome.state == "refined"

    @property
    def per_hour(self) -> float:
        return 3600 * self._done / max(time.monotonic() - self._start, 1e-6)

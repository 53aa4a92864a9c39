"""Where items are done: one protocol, on this machine or in this very process. Ray is in :mod:`ray_executor`."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import suppress
from dataclasses import dataclass, field, replace
from queue import SimpleQueue
from typing import Protocol

from genmf_mi.batch.journal import BatchOutcome
from genmf_mi.batch.supervisor import COMMAND, Share, Supervisor
from genmf_mi.batch.task import Limits, Task
from genmf_mi.core import memory
from genmf_mi.core.config import RefineConfig
from genmf_mi.core.errors import ConfigError

TICK = 1.0
"""Seconds after which an executor yields although nothing has ended."""
DRAFT_GB, DEFAULT_GB, PAPER_GB = 1.4, 1.8, 3.0
"""Memory of a worker by how much it does, with some to spare; see docs/batch.md."""


class Executor(Protocol):
    """Does tasks in any order."""

    def run(self, tasks: Iterator[Task]) -> Iterator[BatchOutcome | None]:
        """Take tasks as there is room for them, and yield outcomes as they come; None now and then in between, so that
        the caller can report."""
        ...

    def memory_gb(self) -> float:
        """What all workers hold now, 0 if that is not known."""
        ...

    def close(self) -> None:
        """End all work at once; what is unfinished can be resumed."""
        ...


def worker_gb(config: RefineConfig) -> float:
    """How much memory a worker needs for refinements with these settings."""
    if config.max_faces <= 40_000 and config.resolution <= 256:
        return DRAFT_GB
    return DEFAULT_GB if config.max_faces <= 160_000 and config.resolution <= 400 else PAPER_GB


def cores() -> list[int]:
    """The cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return sorted(os.sched_getaffinity(0))
    return list(range(os.cpu_count() or 1))


def gpus() -> int:
    """How many GPUs there are, without starting any of them."""
    visible = os.environ.get("CUDA_VISIBLE_DEVICES")
    if visible is not None:
        return len([one for one in visible.split(",") if one.strip() not in ("", "-1")])
    if shutil.which("nvidia-smi") is None:
        return 0
    with suppress(OSError, subprocess.TimeoutExpired):
        done = subprocess.run(["nvidia-smi", "-L"], capture_output=True, text=True, timeout=20, check=False)
        return sum(line.startswith("GPU ") for line in done.stdout.splitlines())
    return 0


def default_workers(config: RefineConfig, threads: int) -> int:
    """As many as cores and memory hold; one per GPU where there are any."""
    if config.device != "cpu" and (count := gpus()):
        return count
    by_memory = int(memory.available_gb() / worker_gb(config))
    return max(1, min(len(cores()) // threads, by_memory))


@dataclass
class LocalExecutor:
    """Worker processes on this machine, each with its share of cores, memory and GPUs.

    workers: 0 for as many as the machine holds. threads: of each worker; 0 shares the cores out.
    config: of most items, to estimate their memory by.
    """

    workers: int = 0
    threads: int = 0
    limits: Limits = field(default_factory=Limits)
    config: RefineConfig = field(default_factory=RefineConfig)
    command: Sequence[str] = COMMAND

    def __post_init__(self) -> None:
        if self.workers < 0 or self.threads < 0:
            raise ConfigError("workers and threads cannot be negative: 0 takes what the machine has.")
        count = self.workers or default_workers(self.config, self.threads or 1)
        on_gpus = gpus() if self.config.device != "cpu" else 0
        own = cores()
        each = self.threads or max(1, len(own) // count)
        limits = self.limits
        if not limits.memory_gb:
            share = max(memory.available_gb() / count, worker_gb(self.config))
            limits = replace(limits, memory_gb=round(share, 1))
        self.supervisors = [
            Supervisor(limits, _share(i, count, each, own, on_gpus), self.command) for i in range(count)
        ]

    def run(self, tasks: Iterator[Task]) -> Iterator[BatchOutcome | None]:
        idle: SimpleQueue[Supervisor] = SimpleQueue()
        for supervisor in self.supervisors:
            idle.put(supervisor)

        def attend(task: Task) -> BatchOutcome:
            supervisor = idle.get()
            try:
                return supervisor.attend(task)
            finally:
                idle.put(supervisor)

        pool = ThreadPoolExecutor(len(self.supervisors), thread_name_prefix="batch")
        pending: set[Future[BatchOutcome]] = set()
        more = True
        try:
            while more or pending:
                while more and len(pending) < len(self.supervisors):
                    task = next(tasks, None)
                    more = task is not None
                    if task is not None:
                        pending.add(pool.submit(attend, task))
                done, pending = wait(pending, timeout=TICK, return_when=FIRST_COMPLETED)
                for future in done:
                    yield future.result()
                if not done:
                    yield None
        finally:
            self.close()
            pool.shutdown(wait=True, cancel_futures=True)

    def memory_gb(self) -> float:
        return sum(supervisor.memory_gb() for supervisor in self.supervisors)

    def close(self) -> None:
        for supervisor in self.supervisors:
            supervisor.close()


def _share(index: int, count: int, threads: int, own: list[int], on_gpus: int) -> Share:
    """Of the worker ``index``: cores of its own while they last; where there are fewer cores than workers, all."""
    first = index * threads
    mine = tuple(own[first : first + threads]) if count * threads <= len(own) else ()
    return Share(threads, mine, index % on_gpus if on_gpus else None)


@dataclass
class InProcess:
    """One item after the other in this process: no limits, no crashes survived, nothing to start. For debugging, and
    for stores that other processes cannot see."""

    def run(self, tasks: Iterator[Task]) -> Iterator[BatchOutcome | None]:
        from genmf_mi.batch.execution import execute
        from genmf_mi.batch.record import ItemRecord

        for task in tasks:
            try:
                ItemRecord.load(task.folder).begin(task)
                answer = execute(task)
                record = ItemRecord.load(task.folder).end()
                yield task.outcome(**answer, peak_memory_gb=round(memory.peak_gb(), 2), attempts=record.begun)
            except OSError as error:
                yield task.outcome("failed", cause="output", error=str(error))

    def memory_gb(self) -> float:
        return memory.resident_gb(os.getpid())

    def close(self) -> None:
        pass

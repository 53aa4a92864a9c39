"""One worker process and what becomes of the items that it is given: limits, crashes, retries, replacement."""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from queue import Empty, SimpleQueue
from typing import IO, Any

from genmf_mi.batch import storage
from genmf_mi.batch.journal import BatchOutcome
from genmf_mi.batch.record import LOST, ItemRecord, worker_name
from genmf_mi.batch.task import Limits, Task
from genmf_mi.batch.worker import CORES, THREADS
from genmf_mi.core import memory
from genmf_mi.core.errors import GenmfError

COMMAND = (sys.executable, "-m", "genmf_mi.batch.worker")
LOOK_EVERY = 0.25
"""Seconds between two looks at the memory of a worker."""
STARTING = 300.0
"""Seconds that a worker may take to start."""
PAUSE = 2.0
"""Seconds before the second attempt of what may pass, doubled each time."""
PASSING = ("output", "setup", "url", "defect")
"""Causes of failures after which another attempt may succeed."""


@dataclass(frozen=True)
class Share:
    """What of the machine a worker has: the threads that it computes with, the cores that it stays on (all if none are
    named), its GPU (an index, or None for what the environment says)."""

    threads: int = 1
    cores: tuple[int, ...] = ()
    gpu: int | None = None

    def environment(self) -> dict[str, str]:
        """For the worker, before it imports anything."""
        threads = str(self.threads)
        values = {THREADS: threads, CORES: ",".join(map(str, self.cores)), "OMP_NUM_THREADS": threads}
        values |= {"MKL_NUM_THREADS": threads, "OPENBLAS_NUM_THREADS": threads}
        if self.gpu is not None:
            values["CUDA_VISIBLE_DEVICES"] = str(self.gpu)
        return {**os.environ, **values}


class Died(Exception):
    """The worker is no more. ``cause`` is ``crash``, ``time`` or ``memory``."""

    def __init__(self, cause: str, message: str) -> None:
        super().__init__(message)
        self.cause = cause


@dataclass
class Supervisor:
    """Has one worker do one item at a time, and starts another worker when that is needed.

    command: that starts a worker, see :mod:`genmf_mi.batch.worker`.
    """

    limits: Limits = field(default_factory=Limits)
    share: Share = field(default_factory=Share)
    command: Sequence[str] = COMMAND

    def __post_init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._answers: SimpleQueue[dict[str, Any] | None] = SimpleQueue()
        self._log: IO[bytes] | None = None
        self._items, self._first_gb, self._closed = 0, 0.0, False

    def attend(self, task: Task) -> BatchOutcome:
        """Do an item, again after crashes and failures that may pass, until there is an outcome."""
        attempts, peak = 0, 0.0
        try:
            while True:
                record = ItemRecord.load(task.folder)
                if not task.afresh and (dead := _quarantined(record, task, self.limits)):
                    return dead
                record = record.begin(task)
                task, attempts = replace(task, afresh=False), attempts + 1
                try:
                    answer, now_gb = self._done(task)
                except Died as death:
                    if self._closed:
                        raise
                    record = ItemRecord.load(task.folder).died(f"{death.cause}: {death}")
                    if death.cause in ("time", "memory"):
                        ItemRecord.load(task.folder).end()
                        return task.outcome("failed", cause=death.cause, error=str(death), attempts=record.begun)
                    task = replace(task, force=task.force and not _begun(task.folder))
                    continue
                peak = max(peak, now_gb)
                record = ItemRecord.load(task.folder).end()
                if answer.get("cause") in PASSING and attempts <= self.limits.retries:
                    time.sleep(PAUSE * 2 ** (attempts - 1))
                    continue
                return task.outcome(**answer, peak_memory_gb=round(peak, 2), attempts=record.begun)
        except (GenmfError, OSError) as error:  # the folder cannot be written
            return task.outcome("failed", cause="output", error=str(error), worker=worker_name())

    def memory_gb(self) -> float:
        """What the worker holds now."""
        return memory.resident_gb(self._process.pid) if self._process else 0.0

    def close(self) -> None:
        """End the worker, whatever it does."""
        self._closed = True
        self._stop()

    def _done(self, task: Task) -> tuple[dict[str, Any], float]:
        """The answer of the worker, and the most memory that it held. Raises :class:`Died`."""
        process = self._started()
        assert process.stdin is not None
        start, peak = time.monotonic(), 0.0
        try:
            pickle.dump(task, process.stdin)
            process.stdin.flush()
        except OSError:
            raise self._death() from None
        while True:
            with suppress(Empty):
                answer = self._answers.get(timeout=LOOK_EVERY)
                if answer is None:
                    raise self._death()
                break
            peak = max(peak, memory.resident_gb(process.pid))
            if self.limits.memory_gb and peak > self.limits.memory_gb:
                self._stop()
                raise Died("memory", f"more than {self.limits.memory_gb:.1f} GB were needed. See --memory-gb.")
            if self.limits.seconds and time.monotonic() - start > self.limits.seconds:
                self._stop()
                raise Died("time", f"it took more than {self.limits.seconds:.0f} s. See --time-limit-s.")
        now = memory.resident_gb(process.pid)
        self._items, self._first_gb = self._items + 1, self._first_gb or now
        if self._items >= self.limits.items or (now - self._first_gb) * 1000 > (self.limits.growth_mb or 1e9):
            self._stop()
        return answer, max(peak, now)

    def _started(self) -> subprocess.Popen[bytes]:
        """The worker, once it is ready. Raises :class:`Died`."""
        if self._closed:
            raise Died("crash", "the batch was stopped")
        if self._process is not None and self._process.poll() is None:
            return self._process
        self._stop()
        self._log = tempfile.TemporaryFile(prefix="genmf-")  # noqa: SIM115
        self._process = subprocess.Popen(
            list(self.command), stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._log,
            env=self.share.environment(), start_new_session=True,
        )  # fmt: skip
        self._answers, self._items, self._first_gb = SimpleQueue(), 0, 0.0
        threading.Thread(target=_listen, args=(self._process, self._answers), daemon=True).start()
        try:
            ready = self._answers.get(timeout=STARTING)
        except Empty:
            ready = None
        if ready is None:
            raise self._death()
        return self._process

    def _death(self) -> Died:
        """Why the worker is gone, with the last that it said."""
        process, said = self._process, ""
        if self._log is not None:
            self._log.seek(max(0, self._log.seek(0, os.SEEK_END) - 2000))
            words = self._log.read().decode(errors="replace").strip().splitlines()
            said = f": {words[-1][:300]}" if words else ""
        code = None
        if process is not None:
            with suppress(subprocess.TimeoutExpired):
                code = process.wait(timeout=5)
        self._stop()
        return Died("crash", f"the worker ended with {_named(code)}{said}")

    def _stop(self) -> None:
        process, self._process = self._process, None
        if process is not None:
            process.kill()
            process.wait()
            for pipe in (process.stdin, process.stdout):
                with suppress(OSError):
                    pipe.close()  # pyright: ignore[reportOptionalMemberAccess]
        if self._log is not None:
            self._log.close()
            self._log = None


def _listen(process: subprocess.Popen[bytes], answers: SimpleQueue[dict[str, Any] | None]) -> None:
    """Pass on what the worker says; None at its end."""
    try:
        while True:
            answers.put(pickle.load(process.stdout))  # pyright: ignore[reportArgumentType]
    except Exception:  # the pipe is closed, or torn in the middle of an answer
        answers.put(None)


def _named(code: int | None) -> str:
    if code is None or code >= 0:
        return f"exit code {code}"
    with suppress(ValueError):
        return signal.Signals(-code).name
    return f"signal {-code}"


def _begun(folder: str) -> bool:
    """Whether there is a checkpoint to go on from."""
    from genmf_mi.pipeline.run_folder import CHECKPOINT, REPLACEMENT

    return any(storage.exists(storage.join(folder, *names)) for names in ((CHECKPOINT,), (REPLACEMENT, CHECKPOINT)))


def _quarantined(record: ItemRecord, task: Task, limits: Limits) -> BatchOutcome | None:
    """The outcome of an item that has crashed too often, if it has."""
    crashes = [death for death in record.deaths if death.startswith("crash")]
    if record.tried != task.key or (len(crashes) < limits.crashes and record.lost < LOST):
        return None
    last = crashes[-1].removeprefix("crash: ") if crashes else "the machine went away"
    error = f"{len(crashes)} crashes and {record.lost} starts without an end; the last: {last}. See --retry-failed."
    return task.outcome("quarantined", cause="crash", error=error, attempts=record.begun, worker=worker_name())

"""The process that does the work: ``python -m genmf_mi.batch.worker``, started by :mod:`genmf_mi.batch.supervisor`.

It reads tasks from standard input and answers on standard output, one after the other, and so pays for imports,
compiled kernels and weights once. It ends with its standard input, whatever it is doing: a supervisor that was killed
leaves no worker behind.
"""

from __future__ import annotations

import gc
import os
import pickle
import sys
import threading
from collections.abc import Callable
from queue import SimpleQueue
from typing import Any, BinaryIO

from genmf_mi.batch.task import Task

THREADS, CORES = "GENMF_BATCH_THREADS", "GENMF_BATCH_CORES"
"""Environment variables that give a worker its share: a number, and numbers with commas between."""


def main(work: Callable[[Task], dict[str, Any]] | None = None) -> None:
    """Do tasks until standard input ends.

    work: what to do with a task; :func:`genmf_mi.batch.execution.execute` if None.
    """
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what libraries print must not come between the answers
    sys.stdout = sys.stderr
    tasks: SimpleQueue[Task] = SimpleQueue()
    threading.Thread(target=_read, args=(sys.stdin.buffer, tasks), daemon=True).start()
    _take_share()
    if work is None:
        from genmf_mi.batch.execution import execute as work
    _answer(answers, {"ready": os.getpid()})
    while True:
        outcome = work(tasks.get())
        from genmf_mi.core import memory

        gc.collect()
        memory.trim_malloc()
        _answer(answers, outcome)


def _read(source: BinaryIO, tasks: SimpleQueue[Task]) -> None:
    try:
        while True:
            tasks.put(pickle.load(source))
    except BaseException:
        os._exit(0)  # nobody is left to answer


def _answer(answers: BinaryIO, answer: dict[str, Any]) -> None:
    try:
        pickle.dump(answer, answers)
        answers.flush()
    except OSError:
        os._exit(0)


def _take_share() -> None:
    """Stay on the cores of this worker, with as many threads."""
    cores = os.environ.get(CORES, "")
    if cores and hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {int(core) for core in cores.split(",")})
    if threads := os.environ.get(THREADS):
        from genmf_mi.render import variant

        variant.limit_threads(int(threads))


if __name__ == "__main__":
    main()

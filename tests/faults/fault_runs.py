"""One small run as its user starts it, and faults that strike it at a chosen point.

As a program it is such a run in a process of its own, which says where it is and waits there for a signal:
``python fault_runs.py STOP_AT ARGUMENTS ...``.
"""

from __future__ import annotations

import os
import shutil
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

HERE = Path(__file__).parent
SMALL = ["--iterations", "4", "--resolution", "64", "--samples", "1", "--max-faces", "2000", "--edge-mm", "6",
         "--device", "cpu", "--no-stress", "--no-score-vgg", "--grey-lpips", "0", "--quiet"]  # fmt: skip


def make_small(patch: pytest.MonkeyPatch) -> None:
    """Small pictures, few displacements, a checkpoint after every second iteration; and for what takes the longest,
    pictures and report that are written as ever but have nothing in them, and no LPIPS."""
    from genmf_mi.core.files import write_text
    from genmf_mi.pipeline import displacement, evaluator, optimisation, problem, results, scoring
    from genmf_mi.render import target

    for module, name, value in (
        (evaluator, "RESOLUTION", 64), (evaluator, "SAMPLES", 1), (target, "FINEST", 3000),
        (displacement, "AMPLITUDES", (0.5,)), (optimisation, "CHECKPOINT_EVERY", 2), (problem, "DETAIL_MM", 60.0),
    ):  # fmt: skip
        patch.setattr(module, name, value)
    for name in ("write_before_after", "write_report"):
        patch.setattr(results, name, lambda path, *_: write_text(path, "<html></html>"))
    patch.setattr(scoring.Scorer, "lpips", lambda _, images, *__: dict.fromkeys(images, (0.5, 0.5)))


class Killed(BaseException):
    """In place of a kill that cannot be caught: nothing on the disk changes any more, whatever handlers do."""


@contextmanager
def killed_at(file: str, count: int = 1) -> Iterator[None]:
    """End a run where ``file`` is to get its final name for the ``count``-th time."""
    dead, left = [False], [count]

    def mortal(original: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **options: Any) -> Any:
            ours = any(Path(str(one)).name == file for one in arguments[1:2])
            left[0] -= ours
            dead[0] |= ours and left[0] == 0
            if dead[0]:
                raise Killed
            return original(*arguments, **options)

        return call

    with pytest.MonkeyPatch.context() as patch:
        for place, name in ((os, "replace"), (Path, "replace"), (Path, "rename")):
            patch.setattr(place, name, mortal(getattr(place, name)))
        for place, name in ((Path, "unlink"), (Path, "rmdir"), (shutil, "rmtree")):
            patch.setattr(place, name, after(dead, getattr(place, name)))
        with suppress(Killed):
            yield
        assert dead[0], f"{file} was not written"


def after(dead: list[bool], original: Callable[..., Any]) -> Callable[..., Any]:
    """Does nothing any more once the process is dead."""

    def call(*arguments: Any, **options: Any) -> Any:
        if dead[0]:
            raise Killed
        return original(*arguments, **options)

    return call


@contextmanager
def failing_at(file: str, error: BaseException, count: int = 1) -> Iterator[None]:
    """Raise ``error`` where the temporary of ``file`` is made for the ``count``-th time."""
    from genmf_mi.core import files

    original, left = files.NamedTemporaryFile, [count]

    def make(*arguments: Any, **options: Any) -> Any:
        if options.get("prefix") == f".{Path(file).stem}-" and options.get("suffix") == Path(file).suffix:
            left[0] -= 1
            if left[0] == 0:
                raise error
        return original(*arguments, **options)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(files, "NamedTemporaryFile", make)
        yield


def main() -> int:
    """The program."""
    signal.signal(signal.SIGINT, signal.default_int_handler)  # tests may run in the background, where it is ignored
    stop_at, arguments = sys.argv[1], sys.argv[2:]
    sys.path.insert(0, str(HERE.parent))
    from genmf_mi.cli.main import main as command
    from genmf_mi.cli.progress import TerminalProgress

    def waiting(original: Callable[..., None]) -> Callable[..., None]:
        def call(self: TerminalProgress, *values: Any) -> None:
            original(self, *values)
            if str(values[0]) in stop_at.split("|"):
                print(f"at {values[0]}", flush=True)
                time.sleep(60)

        return call

    with pytest.MonkeyPatch.context() as patch:
        make_small(patch)
        for name in ("stage", "advance"):
            patch.setattr(TerminalProgress, name, waiting(getattr(TerminalProgress, name)))
        return command(["refine", *arguments])


if __name__ == "__main__":
    sys.exit(main())

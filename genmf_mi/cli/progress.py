"""The progress of long work in the terminal."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Collection, Mapping
from math import isfinite
from types import TracebackType
from typing import TYPE_CHECKING, Any

from genmf_mi.core.progress import Progress

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import TaskID


class TerminalProgress(Progress):
    """A line with the current stage, and for work that is counted a bar with figures and the time left.

    A context manager: the line is shown inside and gone afterwards. Line and warnings go to standard error, so that
    standard output holds results alone; where standard error is not a terminal, only warnings are printed.

    Args:
        quiet: print warnings only.
        shown: names of the values to show, in this order; all of them if None.
        console: where to draw; standard error if None.
    """

    def __init__(
        self, *, quiet: bool = False, shown: Collection[str] | None = None, console: Console | None = None
    ) -> None:
        from rich import progress
        from rich.console import Console

        console = console or Console(stderr=True)
        self._shown, self._stage, self._remaining = shown, "starting", _Remaining()
        self._display = progress.Progress(
            progress.SpinnerColumn(),
            progress.TextColumn("{task.description}", markup=False),
            progress.BarColumn(bar_width=24),
            progress.TextColumn("{task.fields[count]}", markup=False),
            progress.TextColumn("{task.fields[remaining]}", markup=False),
            console=console,
            transient=True,
            redirect_stdout=sys.stdout.isatty(),
            disable=quiet or not console.is_terminal,
        )
        self._task = self._new_task()

    def __enter__(self) -> TerminalProgress:
        self._display.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._display.stop()

    def stage(self, name: str) -> None:
        self._stage = name
        self._display.remove_task(self._task)  # the only way back to a bar without an end
        self._task = self._new_task()

    def advance(self, done: float, total: float, values: Mapping[str, float] | None = None) -> None:
        values = values or {}
        names = [name for name in self._shown if name in values] if self._shown is not None else list(values)
        self._display.update(
            self._task,
            description="  ".join([self._stage, *(f"{name} {values[name]:#.4g}" for name in names)]),
            completed=done,
            total=total,
            count=f"{done / total:.0%}" if total <= 1 else f"{done:.0f}/{total:.0f}",
            remaining=self._remaining.after(done, total),
        )

    def warn(self, message: str) -> None:
        print(f"warning: {message}", file=sys.stderr)  # rich moves it above the line

    def _new_task(self) -> TaskID:
        return self._display.add_task(self._stage, total=None, count="", remaining="")


class JsonProgress(Progress):
    """A JSON object per line on standard output, for programs: ``stage``, or ``done`` and ``total`` with ``values``, or
    ``warning``; and ``at``, the time in seconds since 1970."""

    def stage(self, name: str) -> None:
        self._print({"stage": name})

    def advance(self, done: float, total: float, values: Mapping[str, float] | None = None) -> None:
        finite = {name: value for name, value in (values or {}).items() if isfinite(value)}  # JSON has no others
        self._print({"done": done, "total": total, "values": finite})

    def warn(self, message: str) -> None:
        self._print({"warning": message})

    def _print(self, event: dict[str, Any]) -> None:
        print(json.dumps({"at": round(time.time(), 3), **event}), flush=True)


class _Remaining:
    """Estimates the time left from the pace since the count began, whatever stages it goes through.

    Another count has begun where fewer steps are done than before or the total is another; a training that ends by the
    clock estimates its total anew each time, so totals within 10 % are the same.
    """

    def __init__(self) -> None:
        self._total = self._first = self._last = self._start = 0.0

    def after(self, done: float, total: float) -> str:
        """The time left when ``done`` of ``total`` is done, as "0:02:30 left"; empty while there is no pace yet."""
        now = time.monotonic()
        if done < self._last or abs(total - self._total) > 0.1 * total:
            self._first, self._start = done, now
        self._last, self._total = done, total
        if done <= self._first:
            return ""
        seconds = round((now - self._start) * (total - done) / (done - self._first))
        return f"{seconds // 3600}:{seconds // 60 % 60:02}:{seconds % 60:02} left"

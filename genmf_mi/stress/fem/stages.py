"""The stages of a simulation: their names, their share of the work, and how they are timed and reported."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager

from genmf_mi.core.progress import Progress
from genmf_mi.core.timer import Timer

DONE = {"distance": 0.15, "tetrahedra": 0.3, "heat": 0.5, "elasticity": 0.9, "stress": 0.95}
"""Fraction of a simulation that is done when a stage ends; the rest is left for writing the result."""


@contextmanager
def stage(name: str, timer: Timer, progress: Progress) -> Iterator[None]:
    """A stage of a simulation, one of :data:`DONE`: reported when it begins, timed and advanced when it ends."""
    progress.stage(name)
    yield
    timer.lap(name)
    progress.advance(DONE[name], 1.0)


class PartialProgress(Progress):
    """Reports work that is the part from ``start`` to ``stop`` of a larger one, both as fractions of that."""

    def __init__(self, progress: Progress, start: float, stop: float) -> None:
        self._progress, self._start, self._stop = progress, start, stop

    def stage(self, name: str) -> None:
        self._progress.stage(name)

    def advance(self, done: float, total: float, values: Mapping[str, float] | None = None) -> None:
        self._progress.advance(self._start + (self._stop - self._start) * done / total, 1.0, values)

    def warn(self, message: str) -> None:
        self._progress.warn(message)

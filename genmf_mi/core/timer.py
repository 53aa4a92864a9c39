"""One stopwatch for everything that reports its seconds."""

from __future__ import annotations

import time


class Timer:
    """Wall-clock time by named laps.

    seconds: by the name of the lap; laps of one name add up.
    """

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._start = self._last = time.perf_counter()

    def lap(self, name: str) -> None:
        """Attribute the time since the last lap, or since the timer was made, to ``name``."""
        now = time.perf_counter()
        self.seconds[name] = self.seconds.get(name, 0.0) + now - self._last
        self._last = now

    @property
    def total(self) -> float:
        """Seconds since the timer was made."""
        return time.perf_counter() - self._start

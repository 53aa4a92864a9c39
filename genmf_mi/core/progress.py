"""How long work reports what it does: one protocol for refinements, sweeps, batches, simulations and trainings."""

from __future__ import annotations

from collections.abc import Mapping


class Progress:
    """Receives the progress of long work, and ignores it; subclasses override what they show.

    The methods are called by the thread that does the work, between its steps.
    """

    def stage(self, name: str) -> None:
        """A stage has begun, such as "meshing"."""

    def advance(self, done: float, total: float, values: Mapping[str, float] | None = None) -> None:
        """``done`` of ``total`` steps of the work are finished; ``values`` are figures of the last step, such as the
        loss and its terms."""

    def warn(self, message: str) -> None:
        """The work goes on, but the user should know this: one sentence."""


class PrefixedProgress(Progress):
    """Passes everything on, with ``prefix`` before the names of the stages and the warnings."""

    def __init__(self, progress: Progress, prefix: str) -> None:
        self._progress, self._prefix = progress, prefix

    def stage(self, name: str) -> None:
        self._progress.stage(self._prefix + name)

    def advance(self, done: float, total: float, values: Mapping[str, float] | None = None) -> None:
        self._progress.advance(done, total, values)

    def warn(self, message: str) -> None:
        self._progress.warn(self._prefix + message)

"""Progress bars of the commands."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from genmf_mi.stress.training.config import TrainConfig


@contextmanager
def stages() -> Iterator:
    """A progress bar; yields a function of the stage and the fraction done."""
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}"), BarColumn(bar_width=24), TaskProgressColumn(), TimeElapsedColumn())
    with Progress(*columns, transient=True) as bar:
        task = bar.add_task("starting", total=1.0)
        yield lambda stage, done: bar.update(task, description=stage, completed=done)


@contextmanager
def training(config: TrainConfig) -> Iterator:
    """A progress bar with loss, last validation and time left; yields a :class:`genmf_mi.stress.training.training.Watcher`."""
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

    from genmf_mi.stress.training.training import Watcher

    class Bar(Watcher):
        found = ""

        def step(self, step: int, done: float, loss: float) -> None:
            bar.update(task, description=f"step {step}  loss {loss:.5f}{self.found}", completed=done)

        def validating(self, item: int, count: int) -> None:
            bar.update(task, description=f"validating {item} of {count}")

        def validated(self, step: int, line: dict) -> None:
            self.found = f"  validation {line['validation_mae']:.4f} MPa, IoU {line['validation_iou']:.3f}"

    columns = (TextColumn("{task.description}"), BarColumn(bar_width=24), TaskProgressColumn(), TimeRemainingColumn())
    with Progress(*columns, transient=True) as bar:
        task = bar.add_task(config.preset, total=1.0)
        yield Bar()

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
    """A progress bar with loss, last validation and time left; yields a :class:`genmf_mi.core.progress.Progress`."""
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

    from genmf_mi.core.progress import Progress as Protocol

    class Bar(Protocol):
        def advance(self, done, total, values=None) -> None:
            if values is None:
                bar.update(task, description=f"validating {done} of {total}")
            else:
                text = "  ".join(f"{name} {value:.5f}" for name, value in values.items())
                bar.update(task, description=f"step {done}  {text}", completed=done / total)

    columns = (TextColumn("{task.description}"), BarColumn(bar_width=24), TaskProgressColumn(), TimeRemainingColumn())
    with Progress(*columns, transient=True) as bar:
        task = bar.add_task(config.preset, total=1.0)
        yield Bar()

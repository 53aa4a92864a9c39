"""What a person sees in the terminal while a refinement runs, and the table at its end."""

from __future__ import annotations

from pathlib import Path

from genmf_mi.core.config import RefineConfig
from genmf_mi.pipeline import sweep
from genmf_mi.pipeline.refinement import Listener, refine
from genmf_mi.report import tables
from genmf_mi.report.tables import TextTable

SHOWN = ("loss", "grey_lpips", "ssim", "teacher_depth", "stress_band")
COLUMNS = (
    ("SSIM", "ssim"),
    ("LPIPS", "lpips_alex"),
    ("LPIPS (VGG)", "lpips_vgg"),
    ("g-SSIM", "g_ssim"),
    ("g-LPIPS", "g_lpips"),
)


class Terminal(Listener):
    """A line per step, and a bar with losses and the time left for the iterations."""

    def __init__(self) -> None:
        from rich.progress import (
            BarColumn,
            MofNCompleteColumn,
            Progress,
            SpinnerColumn,
            TextColumn,
            TimeRemainingColumn,
        )

        self.progress = Progress(
            SpinnerColumn(),
            TextColumn("{task.description}"),
            BarColumn(bar_width=24),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
            transient=True,
        )
        self.task = self.progress.add_task("starting", total=None)
        self.heading = ""

    def say(self, text: str) -> None:
        self.progress.update(self.task, description=self.heading + text, total=None, completed=0)

    def iteration(self, index: int, count: int, terms: dict[str, float]) -> None:
        losses = "  ".join(f"{name} {terms[name]:.3f}" for name in SHOWN if name in terms)
        self.progress.update(
            self.task, description=f"{self.heading}refining  {losses}", total=count, completed=index + 1
        )


def run_refine(asset: str, config: RefineConfig, *, out: Path | None, quiet: bool, **options) -> int:
    """``genmf-mi refine``: refine with progress, print the table and where the files are."""
    out = out or Path("runs") / Path(asset).stem
    if quiet:
        result = refine(asset, config, out=out, **options)
    else:
        terminal = Terminal()
        with terminal.progress:
            result = refine(asset, config, out=out, listener=terminal, **options)
    print_table(result.metrics)
    if stress := tables.stress(result.metrics):
        print_cells("thermal stress by finite elements, MPa", stress)
    relief, solid = result.metrics["relief_mm"], result.metrics["solid"]
    print(
        f"relief: at most {relief['max']:.2f} mm, mean {relief['mean']:.2f} mm; "
        f"{'watertight' if solid['watertight'] else 'NOT watertight'}, {solid['bodies']} body, "
        f"{solid['self_intersections']} self-intersections; {result.metrics['seconds']['total']:.0f} s"
    )
    if reason := result.metrics.get("stress_stage_left_out"):
        print(f"no stress stage: {reason}")
    if result.metrics["interrupted"]:
        print(f"interrupted after {result.metrics['iterations']} iterations: the part so far. Continue with --resume.")
    print(f"print {out / 'refined.3mf'}, look at {out / 'report.html'}")
    return 0


def run_sweep(
    asset: str, weights: tuple[float, ...], config: RefineConfig, *, out: Path | None, quiet: bool, **options
) -> int:
    """``genmf-mi sweep``: one refinement per weight with progress, then the table."""
    out = out or Path("runs") / f"{Path(asset).stem}-sweep"
    if quiet:
        found = sweep.sweep(asset, weights, config, out=out, **options)
    else:
        terminal = Terminal()

        def begin(weight: float) -> None:
            terminal.heading = f"stress weight {weight:g}: "

        with terminal.progress:
            found = sweep.sweep(asset, weights, config, out=out, listener=terminal, begin=begin, **options)
    print_cells(f"{found['asset']}: appearance, and thermal stress by finite elements in MPa", sweep.table(found))
    print(f"numbers in {out / sweep.SUMMARY}, picture in {out / sweep.PICTURE}")
    return 0


def run_evaluate(
    original: Path, refined: Path, size_mm: float = 100.0, scene: Path | None = None, json: bool = False
) -> int:
    """Score a one-colour shape against the textured asset that it should look like.

    Args:
        original: The textured asset.
        refined: The one-colour shape, in the same pose (any scale and position).
        size_mm: Longest side of the part.
        scene: A scene file; the sample's own or the default one if not given.
        json: Print JSON instead of a table.
    """
    from genmf_mi.pipeline.evaluation import evaluate

    metrics = evaluate(original, refined, size_mm=size_mm, scene=scene)
    if json:
        from json import dumps

        print(dumps(metrics, indent=2))
    else:
        print_table(metrics)
    return 0


def print_table(metrics: dict) -> None:
    """The scores of all shapes, on the standard and on the unseen views."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title=metrics.get("asset"), title_justify="left")
    table.add_column("")
    for title, _ in COLUMNS:
        table.add_column(title, justify="right")
    for prefix, block in (("", metrics), ("unseen: ", metrics.get("unseen") or {})):
        for row in ("before", "displacement", "unconstrained", "after"):
            if row in block:
                values = [block[row].get(key) for _, key in COLUMNS]
                table.add_row(prefix + row, *("–" if v is None else f"{v:.4f}" for v in values))
        table.add_section()
    Console().print(table)


def print_cells(title: str, cells: TextTable) -> None:
    """Cells that are text already, numbers to the right; where it is narrow, the titles wrap first."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title=title, title_justify="left")
    for i, column in enumerate(cells.columns):
        widest = max(len(row[i]) for row in cells.rows)
        table.add_column(column, justify="right" if i else "left", min_width=widest if i else None)
    for row in cells.rows:
        table.add_row(*row)
    Console().print(table)

"""Tables in the terminal."""

from __future__ import annotations

from genmf_mi.core.text import printable
from genmf_mi.report.tables import TextTable

SCORES = {
    "SSIM": "ssim",
    "LPIPS": "lpips_alex",
    "LPIPS (VGG)": "lpips_vgg",
    "g-SSIM": "g_ssim",
    "g-LPIPS": "g_lpips",
}
"""Columns of :func:`print_scores` and their keys in the metrics."""
SHAPES = ("before", "displacement", "unconstrained", "after")


def print_scores(metrics: dict) -> None:
    """The scores of all shapes in ``metrics.json``: on the standard and the unseen views, and aligned as in GenMF."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    # A name with brackets is no markup
    table = Table(title=Text(printable(str(metrics.get("asset", "")))), title_justify="left")
    table.add_column("")
    for title in SCORES:
        table.add_column(title, justify="right")
    blocks = {"": metrics, "unseen: ": metrics.get("unseen"), "as the paper aligns: ": metrics.get("paper_alignment")}
    for prefix, block in blocks.items():
        for shape in SHAPES:
            if block and shape in block:
                values = [block[shape].get(key) for key in SCORES.values()]
                table.add_row(prefix + shape, *("–" if value is None else f"{value:.4f}" for value in values))
        table.add_section()
    Console().print(table)


def print_table(title: str, cells: TextTable) -> None:
    """Cells that are text already, numbers to the right; in a narrow terminal the titles wrap first."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title=title, title_justify="left")
    for i, column in enumerate(cells.columns):
        widest = max(len(row[i]) for row in cells.rows)
        table.add_column(column, justify="right" if i else "left", min_width=widest if i else None)
    for row in cells.rows:
        table.add_row(*row)
    Console().print(table)

"""The course of a training as a picture."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from genmf_mi.core.files import atomic

PANELS = (("loss", "validation_loss"), ("validation_mae",), ("validation_iou",), ("rate",))
TITLES = ("masked MSE of log(1 + σ/k)", "validation MAE, MPa", "validation IoU of the top 5 %", "learning rate")


def write_curves(path: Path, log: list[dict]) -> None:
    """Draw the lines of ``log.jsonl``; raises :class:`OutputError` where the file cannot be written."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 6.5), layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    for axes, names, title in zip(figure.subplots(2, 2).flat, PANELS, TITLES):
        for name in names:
            points = np.array([(line["step"], line[name]) for line in log if name in line]).reshape(-1, 2)
            if name == "loss":
                axes.plot(*points.T, color="#cccccc", linewidth=0.6)
                points[:, 1] = _running_mean(points[:, 1], max(1, len(points) // 50))
            if len(points):
                axes.plot(*points.T, marker="." if len(points) < 60 else None, label=name.replace("_", " "))
        axes.set_title(title, loc="left", fontsize=10)
        axes.set_xlabel("step", fontsize=9)
        axes.grid(alpha=0.3)
        if names[0] == "loss" and log:
            axes.set_yscale("log")
            axes.legend(frameon=False, fontsize=9)
    with atomic(path) as temporary:
        figure.savefig(temporary, dpi=110)


def _running_mean(values: np.ndarray, width: int) -> np.ndarray:
    """Mean over up to ``width`` values on either side."""
    sums = np.concatenate([[0.0], np.cumsum(values)])
    index = np.arange(len(values))
    low, high = (index - width).clip(0), (index + width + 1).clip(max=len(values))
    return (sums[high] - sums[low]) / (high - low)

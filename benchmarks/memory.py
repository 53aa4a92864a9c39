"""Whether a long refinement keeps its memory flat: resident size over 300 iterations on the strawberry."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from benchmarks import record
from benchmarks.inputs import Inputs
from genmf_mi.core.config import PRESETS
from genmf_mi.core.progress import Progress
from genmf_mi.pipeline.optimisation import CHECKPOINT_EVERY  # follows pipeline
from genmf_mi.pipeline.refinement import refine

ITERATIONS = 300
WINDOW = CHECKPOINT_EVERY
"""Iterations after which a refinement returns freed memory; in between the heap swells and shrinks."""


class ResidentSize(Progress):
    """Records the resident memory after every iteration, in MB."""

    def __init__(self) -> None:
        self.sizes: list[float] = []

    def advance(self, done: float, total: float, values: Mapping[str, float] | None = None) -> None:
        if total == ITERATIONS:
            self.sizes.append(resident_mb())


def main(inputs: Inputs) -> None:
    """Refine the strawberry and look at the lowest size in every window.

    Args:
        inputs: What all benchmarks have in common; this one reads none of them.
    """
    progress = ResidentSize()
    refine("strawberry", replace(PRESETS["draft"], iterations=ITERATIONS), progress=progress)
    sizes = progress.sizes
    lows = [min(sizes[i : i + WINDOW]) for i in range(0, len(sizes), WINDOW)]
    record.write(
        "memory",
        {
            "iterations": len(sizes),
            "mb_lowest_per_window": [round(x) for x in lows],
            "mb_largest": round(max(sizes)),
            "growth_per_100_iterations_mb": round((lows[-1] - lows[2]) / ((len(lows) - 3) * WINDOW) * 100, 2),
        },
    )


def resident_mb() -> float:
    """Resident memory of this process in MB (Linux)."""
    pages = int(Path("/proc/self/statm").read_text(encoding="utf-8").split()[1])
    return pages * 4096 / 1e6

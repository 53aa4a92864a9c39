"""Whether a long refinement keeps its memory flat: resident size over 300 iterations on the strawberry."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from benchmarks import record

ITERATIONS = 300


def main() -> None:
    from genmf_mi.core.config import PRESETS
    from genmf_mi.pipeline.refinement import CHECKPOINT_EVERY, Listener, refine

    sizes: list[float] = []

    class Watch(Listener):
        def iteration(self, index: int, count: int, terms: dict[str, float]) -> None:
            sizes.append(resident_mb())

    refine("strawberry", replace(PRESETS["draft"], iterations=ITERATIONS), listener=Watch())
    # Freed memory goes back every CHECKPOINT_EVERY iterations; in between the heap swells and shrinks
    lows = [min(sizes[i : i + CHECKPOINT_EVERY]) for i in range(0, len(sizes), CHECKPOINT_EVERY)]
    record.write(
        "memory",
        {
            "iterations": len(sizes),
            "mb_lowest_per_window": [round(x) for x in lows],
            "mb_largest": round(max(sizes)),
            "growth_per_100_iterations_mb": round((lows[-1] - lows[2]) / ((len(lows) - 3) * CHECKPOINT_EVERY) * 100, 2),
        },
    )


def resident_mb() -> float:
    """Resident memory of this process in MB (Linux)."""
    pages = int(Path("/proc/self/statm").read_text(encoding="utf-8").split()[1])
    return pages * 4096 / 1e6

"""Parts per hour: warm workers of one thread beside one process of all threads per asset, as a batch once worked."""

from __future__ import annotations

import shutil
import subprocess
import sys
import time
from pathlib import Path

from benchmarks import record
from benchmarks.inputs import Inputs
from genmf_mi.assets import samples
from genmf_mi.batch import journal
from genmf_mi.batch.items import BatchItem
from genmf_mi.core.config import PRESETS

RUNS = Path("runs/benchmarks/batch_throughput")


def main(inputs: Inputs, *, items: int = 16, workers: int = 2) -> None:
    """Draft runs of bundled samples both ways; the machine must be idle otherwise.

    Args:
        inputs: What all benchmarks have in common; this one reads none of them.
        items: Runs each way.
        workers: Worker processes, of as many threads as that leaves each.
    """
    shutil.rmtree(RUNS, ignore_errors=True)
    paths = [samples.resolve(name) for name in samples.NAMES]
    # Another size each, so that no run repeats another
    chosen = [(paths[i % len(paths)], 80.0 + i) for i in range(items)]
    results = {}
    for way, run in (("workers", lambda: _by_workers(chosen, workers)), ("processes", lambda: _by_processes(chosen))):
        start = time.monotonic()
        figures = run()
        seconds = time.monotonic() - start
        results[way] = {"seconds": round(seconds), "parts_per_hour": round(3600 * items / seconds, 1), **figures}
        print(way, results[way], flush=True)
    ratio = results["workers"]["parts_per_hour"] / results["processes"]["parts_per_hour"]
    found = {"machine": record.machine(), "items": items, "workers": workers, "ratio": round(ratio, 2), **results}
    record.write_entry("batch", "throughput", found)


def _by_workers(chosen: list[tuple[Path, float]], workers: int) -> dict:
    """Figures of `run_batch` with local workers."""
    import genmf_mi

    items = [BatchItem(path, f"{path.stem}-{size:g}", {"size_mm": size}) for path, size in chosen]
    outcomes = list(genmf_mi.run_batch(items, PRESETS["draft"], out=RUNS / "workers", workers=workers))
    assert all(one.state == "refined" for one in outcomes), [one.error for one in outcomes]
    by_worker: dict[str, list[float]] = {}
    for one in sorted(journal.latest(journal.read(str(RUNS / "workers"))).values(), key=lambda one: one.ended):
        by_worker.setdefault(one.worker, []).append(one.peak_memory_gb)
    return {
        "cpu_seconds_per_part": round(sum(one.cpu_seconds for one in outcomes) / len(outcomes), 1),
        "peak_gb_by_worker": by_worker,
    }


def _by_processes(chosen: list[tuple[Path, float]]) -> dict:
    """Figures of `genmf-mi refine`, one after the other."""
    before = record.cpu_seconds_of_children()
    for path, size in chosen:
        command = [
            sys.executable, "-m", "genmf_mi", "refine", path, "--out", RUNS / "processes" / f"{path.stem}-{size:g}",
            "--quiet", "--preset", "draft", "--size-mm", size,
        ]  # fmt: skip
        subprocess.run([str(word) for word in command], check=True, stdout=subprocess.DEVNULL)
    cpu = record.cpu_seconds_of_children() - before
    return {"cpu_seconds_per_part": round(cpu / len(chosen), 1)}

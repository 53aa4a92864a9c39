"""Whether ten thousand items are too many: the first start, the way through a finished batch, table and gallery.

The assets are small files, each of its own content; outcomes are made up, by an executor that does nothing.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import genmf_mi
from benchmarks import record
from benchmarks.batch_faults import write_assets
from benchmarks.inputs import Inputs
from genmf_mi.batch.journal import BatchOutcome
from genmf_mi.batch.manifest import read_manifest
from genmf_mi.batch.task import Task
from genmf_mi.pipeline.run_folder import METRICS

RUNS = Path("runs/benchmarks/batch_large")


def main(inputs: Inputs, *, items: int = 10_000) -> None:
    """Time the first start, a second call of a finished batch, and the merge into table and gallery.

    Args:
        inputs: What all benchmarks have in common; this one reads none of them.
        items: Lines of the manifest.
    """
    shutil.rmtree(RUNS, ignore_errors=True)
    manifest, out = write_assets(RUNS / "assets", items, subdivisions=1), RUNS / "out"
    command = [sys.executable, "-m", "genmf_mi", "batch", str(manifest), "--out", str(out)]
    found: dict = {"items": items, "first_item_after_s": first_start(command, out)}
    shutil.rmtree(out)
    count = sum(one.good for one in genmf_mi.run_batch(read_manifest(str(manifest)), out=out, executor=Instantly()))
    assert count == items, count
    for name, words in (("resume", command), ("merge", [sys.executable, "-m", "genmf_mi", "merge", str(out)])):
        start, cpu = time.monotonic(), record.cpu_seconds_of_children()
        subprocess.run(words, check=True, stdout=subprocess.DEVNULL)
        found[f"{name}_s"] = round(time.monotonic() - start, 1)
        found[f"{name}_cpu_s"] = round(record.cpu_seconds_of_children() - cpu, 1)
    found["gallery_mb"] = round((out / "gallery.html").stat().st_size / 1e6, 1)
    print(found)
    record.write_entry("batch", "large", {"machine": record.machine(), **found})


def first_start(command: list[str], out: Path) -> float:
    """Seconds until the first item is in a worker's hands; the batch is ended then."""
    start = time.monotonic()
    batch = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)
    while not any(out.glob("*/item.json")):
        if batch.poll() is not None:
            raise RuntimeError("the batch ended before its first item began")
        time.sleep(0.05)
    seconds = round(time.monotonic() - start, 1)
    os.killpg(batch.pid, signal.SIGTERM)
    batch.wait()
    return seconds


class Instantly:
    """An executor that refines nothing, and says it had."""

    def run(self, tasks: Iterator[Task]) -> Iterator[BatchOutcome]:
        chance = np.random.default_rng(0)
        for task in tasks:
            folder = Path(task.folder)
            folder.mkdir(parents=True, exist_ok=True)
            before, after = float(chance.uniform(0.1, 0.4)), float(chance.uniform(0.05, 0.2))
            scores = {"before": {"lpips_alex": before}, "after": {"lpips_alex": after}}
            (folder / METRICS).write_text(json.dumps(scores), encoding="utf-8")
            named = {"lpips_before": before, "lpips_after": after}
            yield task.outcome("refined", scores=named, seconds=30.0, cpu_seconds=30.0)

    def memory_gb(self) -> float:
        return 0.0

    def close(self) -> None:
        pass

"""Result files, with the machine that they were made on, and CPU seconds.

CPU seconds are those of this process, so that other work on the machine counts little; for wall time there is
:class:`genmf_mi.core.timer.Timer`.
"""

from __future__ import annotations

import json
import os
import platform
import time
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from genmf_mi.core.files import write_text

if TYPE_CHECKING:
    from PIL.Image import Image

FOLDER = Path(__file__).parent / "results"


def write(name: str, results: dict | list) -> None:
    """Write ``results/NAME.json`` and print where it is."""
    path = FOLDER / f"{name}.json"
    write_text(path, json.dumps({"machine": machine(), "results": results}, indent=2) + "\n")
    print(f"written to {path}")


def write_verification(name: str, results: dict | list) -> None:
    """Replace the entry ``name`` of ``results/stress_verification.json``; the others stay."""
    write_entry("stress_verification", name, results)


def write_entry(file: str, name: str, results: dict | list) -> None:
    """Replace the entry ``name`` of ``results/FILE.json``; the others stay."""
    path = FOLDER / f"{file}.json"
    entries = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    write_text(path, json.dumps(entries | {name: results}, indent=1) + "\n")
    print(f"written to {path}, {name}")


def write_sheet(path: Path, strips: Sequence[Image]) -> None:
    """One picture of several, one below the other, for the documentation."""
    from PIL import Image

    tops = np.cumsum([0, *(strip.height for strip in strips)])
    sheet = Image.new("RGB", (max(strip.width for strip in strips), int(tops[-1])), "white")
    for strip, top in zip(strips, tops, strict=False):
        sheet.paste(strip, (0, int(top)))
    sheet.save(path, quality=85)


def machine() -> dict:
    """What a reader needs to judge the figures by."""
    model = platform.processor()
    if Path("/proc/cpuinfo").exists():
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        model = next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), model)
    return {
        "cpu": model,
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "load_at_end": os.getloadavg()[0],
        "python": platform.python_version(),
        **{name: version(name) for name in ("mitsuba", "drjit", "torch")},
    }


def cpu_seconds_of_children() -> float:
    """Of all processes that were started and have ended."""
    times = os.times()
    return times.children_user + times.children_system


def cpu_seconds(work: Callable[[], object], repeats: int = 1, warm_up: bool = False) -> float:
    """CPU seconds of the fastest of ``repeats`` calls of ``work``; with ``warm_up``, after one call that does not
    count."""
    if warm_up:
        work()
    best = float("inf")
    for _ in range(repeats):
        start = time.process_time()
        work()
        best = min(best, time.process_time() - start)
    return round(best, 2)

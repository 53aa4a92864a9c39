"""One JSON per benchmark, with the machine that it ran on."""

from __future__ import annotations

import json
import os
import platform
from importlib.metadata import version
from pathlib import Path

FOLDER = Path(__file__).parent / "results"


def write(name: str, results: dict | list) -> None:
    """Write ``results/NAME.json`` and say so."""
    FOLDER.mkdir(exist_ok=True)
    path = FOLDER / f"{name}.json"
    path.write_text(json.dumps({"machine": machine(), "results": results}, indent=2) + "\n", encoding="utf-8")
    print(f"written to {path}")


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

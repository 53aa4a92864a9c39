"""What the tests of batches share: settings, toy workers, and what these note of themselves."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import genmf_mi
from genmf_mi.batch.executors import LocalExecutor

CONFIG = genmf_mi.RefineConfig(iterations=4, resolution=96, max_faces=1000, device="cpu")
TOY_WORKER = (sys.executable, str(Path(__file__).with_name("toy_worker.py")))


def local(workers: int = 2, **limits: Any) -> LocalExecutor:
    """Toy workers in processes of their own."""
    return LocalExecutor(workers, 1, genmf_mi.Limits(**{"memory_gb": 8.0, **limits}), CONFIG, TOY_WORKER)


def starts(folder: str = "runs") -> list[tuple[str, int]]:
    """Name and first iteration of every start."""
    file = Path(folder, "starts.txt")
    lines = file.read_text().splitlines() if file.exists() else []
    return [(line.split()[0], int(line.split()[1])) for line in lines]

"""A worker whose refinements are those of :mod:`toy_refine`: ``python toy_worker.py``."""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType

sys.path.insert(0, str(Path(__file__).parent))

import toy_refine

from genmf_mi.batch import worker
from genmf_mi.pipeline.run_folder import RunFolder

# The real one would import Mitsuba and torch
stub = ModuleType("genmf_mi.pipeline.refinement")
stub.refine = toy_refine.refine  # type: ignore[attr-defined]
sys.modules["genmf_mi.pipeline.refinement"] = stub
RunFolder.load = toy_refine.load_state  # type: ignore[method-assign]

if __name__ == "__main__":
    import os

    os.environ.pop(worker.THREADS, None)  # of Dr.Jit
    worker.main()

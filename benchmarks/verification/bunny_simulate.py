"""CPU seconds of ``genmf-mi stress simulate`` on the bunny: by stage, and of the whole command."""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks import record
from benchmarks.inputs import Inputs


def main(inputs: Inputs) -> None:
    """Run the command in a process of its own.

    Args:
        inputs: What all benchmarks have in common; this one reads --meshes.
    """
    (mesh,) = inputs.mesh_files(("bunny",))[:1]
    with tempfile.TemporaryDirectory() as folder:
        out, before = Path(folder) / "stress", _cpu_seconds_of_children()
        command = [sys.executable, "-m", "genmf_mi", "stress", "simulate", str(mesh), "--out", str(out)]
        subprocess.run(command, check=True)
        seconds = _cpu_seconds_of_children() - before
        numbers = json.loads((out / "stress.json").read_text(encoding="utf-8"))
    result = {
        "edge_mm": numbers["settings"]["edge_mm"],
        "nodes": numbers["mesh"]["nodes"],
        "mean_mpa": round(numbers["von_mises_mpa"]["mean"], 4),
        "p99_9_mpa": round(numbers["von_mises_mpa"]["p99_9"], 4),
        "cpu_seconds_by_stage": {name: round(value, 1) for name, value in numbers["seconds"].items()},
        "cpu_seconds_whole_command": round(seconds, 1),
    }
    print(result, flush=True)
    record.write_verification("bunny_simulate", result)


def _cpu_seconds_of_children() -> float:
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime

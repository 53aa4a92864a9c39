"""Long checks of the stress solver. ``python -m benchmarks.verification.NAME`` runs one and records what it found."""

from __future__ import annotations

import json

from benchmarks.record import FOLDER
from genmf_mi.core.files import write_text


def record(name: str, results: dict) -> None:
    """Replace the entry ``name`` of ``results/stress_verification.json``; the others stay."""
    path = FOLDER / "stress_verification.json"
    entries = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    write_text(path, json.dumps(entries | {name: results}, indent=1) + "\n")

"""Fixtures of batches: toy refinements in this process or in workers, and small assets."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest
import toy_refine
from toy_batches import CONFIG
from toys import painted

import genmf_mi
from genmf_mi.batch import execution, supervisor
from genmf_mi.batch.journal import BatchOutcome
from genmf_mi.pipeline.run_folder import RunFolder


@pytest.fixture
def toy(monkeypatch) -> None:
    """Refinements in this process are toys."""
    monkeypatch.setattr(execution, "refine", toy_refine.refine)
    monkeypatch.setattr(RunFolder, "load", toy_refine.load_state)
    monkeypatch.setattr(execution, "PATIENCE", 0.0)
    monkeypatch.setattr(supervisor, "PAUSE", 0.0)


@pytest.fixture
def assets(workplace) -> Callable[..., list[str]]:
    """Writes painted eggs of these names, each of its own content; returns their paths."""

    def write(*names: str) -> list[str]:
        paths: list[str] = []
        for name in names:
            path = painted(f"{name}.ply")
            Path(path).write_bytes(Path(path).read_bytes().replace(b"ply\n", f"ply\ncomment {name}\n".encode(), 1))
            paths.append(path)
        return paths

    return write


@pytest.fixture
def batch(toy) -> Callable[..., dict[str, BatchOutcome]]:
    """Runs a batch in this process; outcomes by name."""

    def run(items: Sequence[Any], config: genmf_mi.RefineConfig = CONFIG, **options: Any) -> dict[str, BatchOutcome]:
        return {one.name: one for one in genmf_mi.run_batch(items, config, **{"executor": "inline", **options})}

    return run

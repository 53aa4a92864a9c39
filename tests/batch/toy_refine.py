"""In place of a refinement: one that leaves the same files, obeys the name of its asset, and takes no time.

The names: ``crash`` dies at its second iteration whenever it gets there; ``once`` dies there the first time; ``slow``
takes 0.05 s an iteration; ``hang`` takes forever; ``fat`` takes 1 GB; ``bad`` cannot be refined; ``flaky`` fails the
first time; ``defect`` is a defect of ours. ``starts.txt`` beside the output folders has a line for every start.
"""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path
from types import SimpleNamespace

from genmf_mi.assets.sources import load
from genmf_mi.core.errors import AssetError, OutputError
from genmf_mi.core.files import locked, write_text
from genmf_mi.pipeline import run_folder
from genmf_mi.pipeline.run_folder import CHECKPOINT, HISTORY, METRICS, RunFolder

SCORES = {"ssim": 0.9, "lpips_alex": 0.1, "g_ssim": 0.8}


def refine(asset, config, *, out, force, resume, progress, **options):
    """As :func:`genmf_mi.refine`; the checkpoint is the number of the iteration."""
    out = Path(out)
    with locked(out):
        loaded = load(asset, None, None)
        name = out.name
        folder = RunFolder.open(
            out, loaded.name, config, {"asset": run_folder.fingerprint(loaded)}, force=force, resume=resume
        )
        here = folder.path
        first = int((here / CHECKPOINT).read_text()) if resume else 0
        with (out.parent / "starts.txt").open("a") as file:
            file.write(f"{name} {first} {os.getpid()}\n")
        _obey(name, out)
        for i in range(first, config.iterations):
            if i == 2 and (name.startswith("crash") or (name.startswith("once") and _first_time(out))):
                os.kill(os.getpid(), signal.SIGKILL)
            if name.startswith("slow"):
                time.sleep(0.05)
            write_text(here / HISTORY, "{}\n" * (i + 1))
            write_text(here / CHECKPOINT, str(i + 1))
            progress.advance(i + 1, config.iterations, {})
        if name.startswith("thin"):
            progress.warn("it is thin")
        metrics = {"before": SCORES, "after": SCORES, "iterations": config.iterations, "options": sorted(options)}
        if options.get("verify"):
            metrics["stress"] = {}
        folder.finish(metrics)
        return SimpleNamespace(metrics=metrics)


def _obey(name: str, out: Path) -> None:
    if name.startswith("bad"):
        raise AssetError("bad.glb is empty.")
    if name.startswith("flaky") and _first_time(out):
        raise OutputError("the disk is full.")
    if name.startswith("defect"):
        raise ZeroDivisionError("a defect")
    if name.startswith("hang"):
        time.sleep(1000)
    if name.startswith("fat"):
        keep = b"x" * 1_000_000_000
        time.sleep(1000 + len(keep))


def _first_time(out: Path) -> bool:
    mark = out / "seen"
    if mark.exists():
        return False
    mark.touch()
    return True


def load_state(folder: RunFolder):
    """In place of :meth:`RunFolder.load`, which reads a checkpoint of torch."""
    try:
        return int((folder.path / CHECKPOINT).read_text()), []
    except ValueError as error:
        raise OutputError(f"the checkpoint in {folder.path} is damaged. Start again with --force.") from error


__all__ = ["METRICS", "load_state", "refine"]

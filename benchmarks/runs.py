"""Refinements from the command line, each in a process of its own, so that time and memory are its alone."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import trimesh

from genmf_mi.core.frame import Frame
from genmf_mi.pipeline.run_folder import CHECKPOINT, METRICS


def refined(source: Path, folder: Path, *arguments: str | Path) -> dict | None:
    """The metrics of the refinement of ``source`` in ``folder``; it is made, or resumed, unless it is finished there.

    arguments: more for ``genmf-mi refine``.

    Returns None if the refinement failed; what went wrong is printed by it.
    """
    path = folder / METRICS
    if not path.exists() or (folder / CHECKPOINT).exists():
        mode = "--resume" if (folder / CHECKPOINT).exists() else "--force"
        command = [sys.executable, "-m", "genmf_mi", "refine", source, "--out", folder, "--quiet", mode, *arguments]
        subprocess.run([str(part) for part in command], check=False)
    complete = path.exists() and not (folder / CHECKPOINT).exists()
    return json.loads(path.read_text(encoding="utf-8")) if complete else None


def refined_shape(folder: Path, frame: Frame) -> tuple[np.ndarray, np.ndarray]:
    """Vertices ``[V,3]`` in the normalised frame, and faces ``[F,3]``, of the refinement in ``folder``."""
    part = trimesh.load_mesh(folder / "refined.glb", process=False)
    return frame.normalise(np.asarray(part.vertices)), np.array(part.faces)

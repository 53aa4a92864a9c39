"""What one input goes through: all that happens before the optimisation, and what would be refused only after it."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from types import SimpleNamespace

import fuzz_seeds
import torch

from genmf_mi.assets import sources
from genmf_mi.core.config import RefineConfig
from genmf_mi.core.progress import Progress
from genmf_mi.fabrication import files
from genmf_mi.geometry.uniform_adam import UniformAdam
from genmf_mi.mesh import rebuild, solid
from genmf_mi.pipeline import evaluator, problem
from genmf_mi.pipeline.run_folder import RunFolder, fingerprint
from genmf_mi.render import bridge, scene_file, target, variant
from genmf_mi.render import scene as scenes

CONFIG = RefineConfig(max_faces=2000, resolution=64, samples=1, device="cpu", stress=False)


class AfterTheWork(Exception):
    """A refusal that would have come after the last iteration."""


class Noted(Progress):
    """Remembers whether there was a warning."""

    def __init__(self) -> None:
        self.warnings: list[str] = []

    def warn(self, message: str) -> None:
        self.warnings.append(message)


def make_affordable() -> None:
    """Coarse grids, references and pictures; for the whole process."""
    variant.use("cpu")
    evaluator.RESOLUTION, evaluator.SAMPLES, target.FINEST = 64, 1, 2000
    solid.rebuild.rebuild = partial(rebuild.rebuild, cells=40)
    solid.voids.CELLS = 40


def drive(kind: str, path: Path, scratch: Path) -> list[str]:
    """Put the file ``path`` of a kind through the program; returns the warnings, and raises what comes."""
    progress = Noted()
    if kind == "image":
        target.read_picture(f"{path}@0,20")
    elif kind == "run":
        _resume(path.parent)
    elif kind == "scene":
        bridge.write_ply(scratch / "trial.ply", *TRIANGLE)
        bridge.render(
            scenes.load(path, scratch / "trial.ply", radius=1.0, resolution=32, samples=1), [scenes.View(0, 0)]
        )
    else:
        _prepare(path, scratch, progress)
    return progress.warnings


TRIANGLE = torch.eye(3).numpy(), torch.tensor([[0, 1, 2]]).numpy()


def _prepare(path: Path, scratch: Path, progress: Noted) -> None:
    asset = sources.load(path)
    fingerprint(asset)
    references = () if asset.textured else (_picture(scratch),)
    made = problem.build_problem(
        asset, CONFIG, scene_file.find("default"), scratch, references=references, progress=progress
    )
    surface = made.surface
    try:
        files.write(scratch, surface.vertices, surface.faces, made.frame, surface.rgb, asset.name)
    except Exception as error:
        raise AfterTheWork(str(error)) from error


def _picture(folder: Path) -> str:
    """A reference for what has no colours."""
    fuzz_seeds.texture("RGBA").save(folder / "reference.png")
    return f"{folder / 'reference.png'}@0,20"


def _resume(folder: Path) -> None:
    run = RunFolder(folder)
    run.settings()
    (folder / "metrics.json").rename(folder / "kept.json")
    checkpoint, _ = run.load()
    parameter = torch.zeros(5, 3, requires_grad=True)
    optimiser = UniformAdam((parameter,), 0.1)
    from genmf_mi.pipeline.optimisation import Optimisation

    work = Optimisation(SimpleNamespace(), CONFIG, SimpleNamespace(parameters=(parameter,)), SimpleNamespace())
    work.restore(checkpoint)
    parameter.grad = torch.ones(5, 3)
    work.optimiser.step()
    del optimiser
    (folder / "checkpoint.pt").unlink()
    (folder / "kept.json").rename(folder / "metrics.json")
    run.metrics()

"""How far can relief lower the stress at all? Descent along the gradient of the stress alone, verified by the solver.

The surface of each asset moves within the displacement bounds of a refinement, from its initial shape, without any loss
of the appearance. The stress of the result is as low as a stress stage could bring it if appearance were free.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import torch

from benchmarks import record
from benchmarks.inputs import Inputs
from benchmarks.stress_stage import MEASURES
from genmf_mi.assets import sources
from genmf_mi.core.config import RefineConfig
from genmf_mi.geometry.uniform_adam import UniformAdam
from genmf_mi.pipeline.problem import build_problem, parameterize  # follows pipeline.problem
from genmf_mi.render import variant
from genmf_mi.render.scene_file import find
from genmf_mi.sdf.distance import signed_distance
from genmf_mi.stress.fem.following import MEASURES as MEASURES_OF_BODY
from genmf_mi.stress.fem.following import FollowingBody
from genmf_mi.stress.fem.settings import Settings
from genmf_mi.stress.penalty import by_solver
from genmf_mi.stress.report import verification

TWO_ASSETS = ("hunyuan_bus", "spot")


def main(inputs: Inputs, *, steps: int = 16, rate: float = 0.0, threads: int = 1) -> None:
    """Descend, simulate, tabulate.

    Args:
        inputs: What all benchmarks have in common; this one reads --assets.
        steps: Of the optimiser; the stress is evaluated at each.
        rate: Learning rate; ten times that of a refinement, which makes more steps, if 0.
        threads: Of the CPU.
    """
    torch.set_num_threads(threads)
    rows = []
    for path in inputs.asset_files(TWO_ASSETS):
        rows.append({"asset": path.stem, **descend(path, steps, rate)})
        print(rows[-1], flush=True)
    record.write("stress_limit", {"steps": steps, "assets": rows})


def descend(path: Path, steps: int, rate: float) -> dict:
    """Returns ``told`` and ``found``, the measures on the mesh that follows the surface and on a fine one of its own,
    each over that of the initial shape, and ``moved_mm``, mean and largest displacement of a vertex."""
    config = RefineConfig()
    rate = rate or 10 * config.learning_rate
    asset = sources.load(path)
    device = variant.use(config.device)
    with tempfile.TemporaryDirectory() as folder:
        problem = build_problem(asset, config, find(asset.name), Path(folder))
    mm, initial = problem.frame.mm_per_unit, problem.surface
    relief, settings = parameterize(problem, config, device), Settings()
    body = FollowingBody(signed_distance(initial.vertices, initial.faces, settings.grid), problem.frame, settings)
    measure = by_solver(body, relief.follow(body.points, body.reach))
    with torch.no_grad():
        before = measure(relief.initial_shape)
    optimiser = UniformAdam(relief.parameters, rate)
    for step in range(steps):
        ratios = measure(relief.geometry().shape) / before
        ratios.sum().backward()
        optimiser.rates = [rate * min(1.0, 3 * (steps - step) / steps)]
        optimiser.step()
        print(step, [round(value, 4) for value in ratios.tolist()], flush=True)
    with torch.no_grad():
        predicted = dict(zip(MEASURES_OF_BODY, (measure(relief.geometry().shape) / before).tolist(), strict=True))
    vertices, faces = relief.surface(relief.state())
    shapes = {"before": (initial.vertices, initial.faces), "after": (vertices, faces)}
    simulated = verification.verify(shapes, problem.frame)["ratio"]["after"]
    moved_mm = np.linalg.norm(vertices - initial.vertices, axis=1) * mm
    return {
        "told": {key: round(value, 4) for key, value in predicted.items()},
        "found": {key: round(simulated[key], 4) for key in MEASURES},
        "moved_mm": [round(float(moved_mm.mean()), 3), round(float(moved_mm.max()), 3)],
    }

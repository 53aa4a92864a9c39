"""How much of the look filament can hold at all: free heights, one view, no regulariser.

For one view at a time, from which alone it is judged, the relief is optimised as for a printer of layers, but without
any regulariser, without jitter, and without regard to what is plain; then printed and looked at by the gate. What it
gains there is about as much as any relief within the cap could.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from benchmarks import record
from benchmarks.as_printed import LIGHTS, PRINTER
from benchmarks.inputs import Inputs
from benchmarks.runs import refined_shape
from genmf_mi.assets.asset import load
from genmf_mi.core.config import PRESETS, RefineConfig, Weights
from genmf_mi.core.printer import PRINTERS
from genmf_mi.core.progress import Progress
from genmf_mi.mesh.self_intersections import self_intersections
from genmf_mi.pipeline import views
from genmf_mi.pipeline.as_printed import PrintGate, paint_of, scores
from genmf_mi.pipeline.displacement import best_displacement, initial_heights
from genmf_mi.pipeline.evaluator import build_evaluator
from genmf_mi.pipeline.optimisation import Optimisation, optimise
from genmf_mi.pipeline.problem import RefinementProblem, build_problem, parameterize
from genmf_mi.render import scene_file, variant
from genmf_mi.render.view import View

ASSETS = ("hunyuan_bus", "sf3d_raccoon", "spot")
CAPS_MM = (1.0, 3.0)
FREE = Weights(normal_smoothness=0.0, teacher_depth=0.0, teacher_normal=0.0, normal_flip=0.0)
"""Only what is seen."""


def main(inputs: Inputs, *, iterations: int = 200) -> None:
    """Optimise for one view, print, look.

    Args:
        inputs: What all benchmarks have in common; this one reads --assets, and the runs of as_printed.
        iterations: Of the optimisation, each of the same view.
    """
    variant.use("auto")
    rows: dict[str, dict] = {}
    for path in inputs.asset_files(ASSETS):
        run = inputs.out / PRINTER / path.stem
        if (run / "refined.glb").exists():
            rows[path.stem] = bound(path, run, iterations)
            print(path.stem, rows[path.stem], flush=True)
    record.write("print_bound", {"iterations": iterations, "assets": rows})


def bound(path: Path, run: Path, iterations: int) -> dict[str, Any]:
    """LPIPS in the most telling view of the untouched part, of the part in ``run``, and of the free ones."""
    asset = load(path)
    xml = scene_file.find(asset.name)
    config = replace(PRESETS["default"], stress=False, printer=PRINTER, iterations=iterations, weights=FREE, grain=0.0)
    with tempfile.TemporaryDirectory(prefix="genmf-") as folder:
        shapes: dict[str, tuple[np.ndarray, np.ndarray]] = {}
        for cap_mm in CAPS_MM:
            free = replace(config, max_relief_mm=cap_mm)
            problem = build_problem(asset, free, xml, Path(folder))
            evaluator = build_evaluator(problem.evaluation.reference, problem.evaluation.part, ("alex",))
            view = evaluator.scorer.most_telling
            shapes[f"free, {cap_mm:g} mm"] = one_view(problem, free, evaluator.views[view])
        surface = problem.surface
        shapes = {"before": (surface.vertices, surface.faces), "refined": refined_shape(run, problem.frame)} | shapes
        radius = float(np.linalg.norm(surface.vertices, axis=1).max())
        gate = PrintGate(problem.frame, radius, PRINTERS[PRINTER], None, xml, Path(folder))
        paint = paint_of(problem)
        looks = {name: gate.look(f"part{i}", *shape, paint if name == "before" else None)
                 for i, (name, shape) in enumerate(shapes.items())}  # fmt: skip
    table = scores(looks, view=view)
    return {light: {name: round(table[light][name]["lpips_alex"], 4) for name in shapes} for light in LIGHTS}


def one_view(problem: RefinementProblem, config: RefineConfig, view: View) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of the relief that was optimised for ``view`` alone, plain areas free to move."""
    problem = replace(problem, bounds=problem.loose_bounds)
    evaluator = build_evaluator(problem.evaluation.reference, problem.evaluation.part, ("alex",))
    displacement = best_displacement(problem, evaluator, Progress())
    parameterization = parameterize(problem, config, variant.use("auto"))
    parameterization.set_heights(initial_heights(problem, displacement, config))
    alignment = replace(evaluator.alignment, kind=config.alignment)
    with patch.object(views, "sample_view", lambda *_: view):
        optimise(Optimisation(problem, config, parameterization, alignment), None, Progress())
    refined = parameterization.finish(parameterization.state(), self_intersections)
    return refined.vertices, refined.faces

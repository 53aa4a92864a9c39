"""Ours beside what slicers and texture-to-relief tools do, at the same cap and on the same mesh.

- ``tools``: every point raised by the cap times the brightness of the texture, which is what a displacement map is.
- ``displacement``: the best of six displacements, both signs, about the median brightness and stretched to the cap.
- ``refined``: the default preset without the stress stage.

The scores are those of the evaluation protocol, one exposure for all parts; the picture shows the view in which the
textured object has the most contrast.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from benchmarks import record
from benchmarks.inputs import EIGHT_ASSETS, Inputs
from benchmarks.runs import refined, refined_shape
from genmf_mi.assets.asset import load
from genmf_mi.core.config import PRESETS
from genmf_mi.core.progress import Progress
from genmf_mi.pipeline.displacement import best_displacement
from genmf_mi.pipeline.evaluator import Evaluator, build_evaluator
from genmf_mi.pipeline.problem import RefinementProblem, build_problem
from genmf_mi.render import bridge, scene_file, variant
from genmf_mi.report.pictures import compose, plastic, write_row

METHODS = ("before", "tools", "displacement", "refined")
SCORES = ("lpips_alex", "ssim", "g_ssim", "outline_iou")
PICTURE = Path(__file__).parents[1] / "docs" / "comparison.jpg"


def main(inputs: Inputs) -> None:
    """Refine the eight assets of the README, displace them in two other ways, and compare.

    Args:
        inputs: What all benchmarks have in common; this one reads --assets.
    """
    variant.use("auto")
    rows: dict[str, dict] = {}
    strips: list[Image.Image] = []
    for path in inputs.asset_files(EIGHT_ASSETS):
        folder = inputs.out / "assets" / path.stem
        if refined(path, folder, "--no-stress") is None:
            continue
        config = replace(PRESETS["default"], stress=False)
        with tempfile.TemporaryDirectory(prefix="genmf-") as name:
            asset = load(path)
            problem = build_problem(asset, config, scene_file.find(asset.name), Path(name))
            evaluator = build_evaluator(problem.evaluation.reference, problem.evaluation.part, ("alex",))
            parts = {method: evaluator.render(*shape) for method, shape in shapes(problem, evaluator, folder).items()}
            table = evaluator.verdicts(parts)
            rows[path.stem] = {m: {key: round(table[m][key], 4) for key in SCORES} for m in METHODS}
            write_strip(Path(name) / "strip.png", evaluator, parts)
            strips.append(Image.open(Path(name) / "strip.png").convert("RGB"))
        print(path.stem, rows[path.stem], flush=True)
    falls = {
        method: round(
            float(np.mean([1 - row[method]["lpips_alex"] / row["before"]["lpips_alex"] for row in rows.values()])), 3
        )
        for method in METHODS[1:]
    }
    record.write("comparison", {"assets": rows, "mean_lpips_fall": falls})
    record.write_sheet(PICTURE, strips)


def shapes(
    problem: RefinementProblem, evaluator: Evaluator, folder: Path
) -> dict[str, tuple[torch.Tensor, torch.Tensor]]:
    """Vertices and faces in the normalised frame by the names of :data:`METHODS`; the refined one from its folder."""
    surface = problem.surface
    best = best_displacement(problem, evaluator, Progress()).heights
    tools = surface.brightness * problem.loose_bounds.outward
    made = {name: (surface.vertices + height[:, None] * surface.normals, surface.faces)
            for name, height in (("before", 0 * best), ("tools", tools), ("displacement", best))}  # fmt: skip
    made["refined"] = refined_shape(folder, problem.frame)
    return {
        name: (torch.as_tensor(v, dtype=torch.float32, device=evaluator.device),
               torch.as_tensor(np.array(f), device=evaluator.device))
        for name, (v, f) in made.items()
    }  # fmt: skip


def write_strip(path: Path, evaluator: Evaluator, parts: dict[str, bridge.Buffers]) -> None:
    """The textured object and the parts side by side, in the view of the most contrast."""
    i = evaluator.scorer.most_telling
    colour = evaluator.render_colour([evaluator.views[i]])[0]
    pictures = [compose(colour, evaluator.mask[i, 0].cpu().numpy())]
    for part in parts.values():
        coverage = part.geometry[2][i, 0].cpu().numpy()
        pictures.append(compose(plastic(part.grey[i, 0].cpu().numpy()), coverage))
    write_row(
        path, pictures, ("textured model", "printed as it is", "texture as height", "best displacement", "refined")
    )

"""What is left of the look once the part is printed: the gate's verdict, not that of the model that was optimised.

- ``displacement``: the best of six displacements by brightness, chosen on smooth surfaces.
- ``smooth``: the default preset, for ``--printer smooth``. ``printer``: the same for ``--printer fdm-0.2``.

All are sliced for ``fdm-0.2``, and every bead that can be seen is modelled; see :mod:`genmf_mi.pipeline.as_printed`.
"""

from __future__ import annotations

import json
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

from benchmarks import record
from benchmarks.inputs import EIGHT_ASSETS, Inputs
from benchmarks.runs import refined, refined_shape
from genmf_mi.assets.asset import load
from genmf_mi.core.config import PRESETS
from genmf_mi.core.progress import Progress
from genmf_mi.pipeline.as_printed import LAMPS, TWO_LIGHTS
from genmf_mi.pipeline.displacement import best_displacement
from genmf_mi.pipeline.evaluator import build_evaluator
from genmf_mi.pipeline.print_check import LIGHTS as LIGHTS_SHOWN
from genmf_mi.pipeline.print_check import check_shapes
from genmf_mi.pipeline.problem import build_problem
from genmf_mi.render import scene_file, variant
from genmf_mi.report.pictures import write_row

PRINTER = "fdm-0.2"
LIGHTS = (TWO_LIGHTS, LAMPS)
SHAPES = ("before", "displacement", "smooth", "printer")
SCORES = ("lpips_alex", "ssim", "g_ssim")
PICTURE = Path(__file__).parents[1] / "docs" / "as_printed.jpg"


def main(inputs: Inputs, *, slicer: str = "own") -> None:
    """Refine the eight assets of the README for smooth parts and for filament, print both, and compare.

    Args:
        inputs: What all benchmarks have in common; this one reads --assets.
        slicer: own for ours, auto for the one that is installed, or a program.
    """
    variant.use("auto")
    rows: dict[str, dict] = {}
    strips: list[Image.Image] = []
    for path in inputs.asset_files(EIGHT_ASSETS):
        smooth, printer = inputs.out / "assets" / path.stem, inputs.out / PRINTER / path.stem
        failed = refined(path, smooth, "--no-stress") is None
        if failed or refined(path, printer, "--no-stress", "--printer", PRINTER) is None:
            continue
        verdict, picture = printer / f"gate_{slicer}.json", printer / f"gate_{slicer}.png"
        if not (verdict.exists() and picture.exists()):
            verdict.write_text(json.dumps(printed(path, smooth, printer, slicer, picture), indent=1))
        rows[path.stem] = json.loads(verdict.read_text())
        strips.append(Image.open(picture).convert("RGB"))
        print(path.stem, rows[path.stem], flush=True)
    record.write("as_printed", {"slicer": slicer, "assets": rows, "summary": summary(rows)})
    record.write_sheet(PICTURE, strips)


def printed(path: Path, smooth: Path, printer: Path, slicer: str, picture: Path) -> dict:
    """Scores of one asset by lighting and shape, and what its printing takes; its picture under lamps is written."""
    config = replace(PRESETS["default"], stress=False)
    with tempfile.TemporaryDirectory(prefix="genmf-") as folder:
        asset = load(path)
        xml = scene_file.find(asset.name)
        problem = build_problem(asset, config, xml, Path(folder))
        evaluator = build_evaluator(problem.evaluation.reference, problem.evaluation.part, ("alex",))
        best, surface = best_displacement(problem, evaluator, Progress()).heights, problem.surface
        shapes = {
            "before": (surface.vertices, surface.faces),
            "displacement": (surface.vertices + best[:, None] * surface.normals, surface.faces),
            "smooth": refined_shape(smooth, problem.frame),
            "printer": refined_shape(printer, problem.frame),
        }
        check = check_shapes(problem, shapes, PRINTER, slicer, xml, Path(folder), Progress())
    names = ("painted", "printed as it is", "best displacement", "refined, --printer smooth", f"--printer {PRINTER}")
    write_row(picture, check.rows[LIGHTS_SHOWN[LAMPS]], names)
    scores = {
        light: {
            **{shape: {k: round(check.metrics[light][shape][k], 4) for k in SCORES} for shape in SHAPES},
            "paper_alignment": {
                shape: round(check.metrics[light]["paper_alignment"][shape]["lpips_alex"], 4) for shape in SHAPES
            },
        }
        for light in LIGHTS
    }
    return {**scores, "parts": check.metrics["parts"]}


def summary(rows: dict[str, dict]) -> dict:
    """Mean falls of LPIPS by lighting and shape, and how they compare with displacement's and the smooth part's."""
    table: dict[str, dict] = {}
    for light in LIGHTS:
        fall = {
            shape: float(np.mean([1 - row[light][shape]["lpips_alex"] / row[light]["before"]["lpips_alex"]
                                  for row in rows.values()]))
            for shape in SHAPES[1:]
        }  # fmt: skip
        table[light] = {
            "mean_lpips_fall": {shape: round(value, 3) for shape, value in fall.items()},
            "gain_over_displacement": round(fall["printer"] / fall["displacement"], 2),
            "gain_over_smooth": round(fall["printer"] / fall["smooth"], 2),
            "ahead_of_displacement": sum(
                row[light]["printer"]["lpips_alex"] < row[light]["displacement"]["lpips_alex"] for row in rows.values()
            ),
        }
    return table

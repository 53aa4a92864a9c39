"""How much stress does relief add, and what is left of that with the stress stage: caps on the relief, mesh and field.

Every part is simulated by fine elements. ``away`` leaves out what lies within three clamp heights of the bed, where the
maximum is that of the clamp.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks import record
from benchmarks.inputs import Inputs
from benchmarks.runs import refined, refined_shape
from genmf_mi.assets import sources
from genmf_mi.assets.sdf_asset import SdfAsset
from genmf_mi.core.config import PRESETS
from genmf_mi.core.frame import Frame
from genmf_mi.mesh import solid
from genmf_mi.render import variant
from genmf_mi.sdf import distance
from genmf_mi.stress.fem.settings import Settings
from genmf_mi.stress.fem.simulation import Simulation, simulate_distance
from genmf_mi.stress.fem.statistics import weighted_percentiles
from genmf_mi.stress.report.comparison import layer_ratio
from genmf_mi.stress.report.verification import EDGE_MM

ASSETS = ("hunyuan_bus", "sf3d_raccoon")
CAPS_MM = (1.0, 2.0, 4.0, 8.0)
AWAY = 3.0
"""Clamp heights above the bed from where on the maximum counts as ``away``."""
STAGES = {"without": ("--no-stress",), "with": ("--stress",)}


def main(inputs: Inputs, *, caps_mm: tuple[float, ...] = CAPS_MM, plain_moves: bool = False) -> None:
    """Refine with every cap, with and without the stage, and simulate.

    Args:
        inputs: What all benchmarks have in common; this one reads --assets.
        caps_mm: On the relief.
        plain_moves: Weigh the appearance as the paper does, without what holds plain areas.
    """
    variant.use("auto")
    weights = ("--weights.ssim", "0", "--weights.teacher-depth", "0", "--alignment", "paper", "--grain", "0")
    rows = []
    for path in inputs.asset_files(ASSETS):
        before: tuple[Simulation, Frame] | None = None
        for cap in caps_mm:
            for stage, words in STAGES.items():
                name = f"{path.stem}_{cap:g}_{stage}{'_paper' * plain_moves}"
                more = (*words, "--max-relief-mm", f"{cap:g}", *(weights if plain_moves else ()))
                metrics = refined(path, inputs.out / "stress_regime" / name, *more)
                if metrics is None:
                    continue
                before = before or untouched(path)
                after = simulated(*refined_shape(inputs.out / "stress_regime" / name, before[1]), before[1])
                row = {"asset": path.stem, "cap_mm": cap, "stage": stage, **figures(before[0], after, metrics)}
                rows.append(row)
                print(row, flush=True)
    record.write("stress_regime" + "_paper" * plain_moves, {"assets": rows})


def untouched(path: Path) -> tuple[Simulation, Frame]:
    """The part before any relief, and its frame."""
    asset = sources.load(path)
    assert not isinstance(asset, SdfAsset)
    body = solid.solidify(asset.name, asset.vertices, asset.matter)
    frame = Frame.of(body.vertices, PRESETS["default"].size_mm)
    return simulated(frame.normalise(body.vertices), body.faces, frame), frame


def simulated(vertices: np.ndarray, faces: np.ndarray, frame: Frame) -> Simulation:
    """By fine elements, of a surface in the normalised frame."""
    settings = Settings(size_mm=frame.size_mm, edge_mm=EDGE_MM)
    return simulate_distance(distance.signed_distance(vertices, faces, settings.grid), frame, settings)


def figures(before: Simulation, after: Simulation, metrics: dict) -> dict:
    """Ratios of maximum (p99.9), mean and surface layer, and of the maximum away from the clamp; LPIPS and relief."""
    one, two = summarised(before), summarised(after)
    return {
        "ratio": {name: round(two[name] / one[name], 4) for name in one}
        | {"surface_layer": round(layer_ratio(before, after) or np.nan, 4)},
        "lpips": [round(metrics[shape]["lpips_alex"], 4) for shape in ("before", "after")],
        "relief_mm": {key: round(value, 3) for key, value in metrics["relief_mm"].items()},
        "plain_p95_mm": round(metrics["plain_distortion_mm"]["p95"], 3),
        "seconds": round(metrics["seconds"]["total"], 1),
    }


def summarised(simulation: Simulation) -> dict[str, float]:
    """Mean, p99.9, and p99.9 away from the clamp, in MPa."""
    value, volume, mesh = simulation.field.von_mises, simulation.field.elements.volumes, simulation.field.mesh
    height = mesh.points[mesh.cells][..., 2].mean(axis=1)
    away = height > AWAY * simulation.settings.protocol.clamp_fraction * height.max()
    return {
        "mean": float(np.average(value, weights=volume)),
        "max": weighted_percentiles(value, volume, (99.9,))[0],
        "max_away": weighted_percentiles(value[away], volume[away], (99.9,))[0],
    }

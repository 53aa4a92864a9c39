"""How much stress does relief add, and what is left of that with the stress stage?

Caps on the relief, the route over a mesh and over a field, our weights and those of the paper, with and without the
stage. Every part is simulated by fine elements. ``away`` leaves out what lies within three clamp heights of the bed,
where the maximum is that of the clamp. The largest cap that a refinement takes, a tenth of the part, is as good as
none: relief does not use it.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from benchmarks import record
from benchmarks.inputs import Inputs
from benchmarks.runs import refined, refined_shape
from benchmarks.sdf_route import SAMPLES, field_of
from genmf_mi.assets import sources
from genmf_mi.assets.sdf_asset import SdfAsset
from genmf_mi.core.config import PRESETS
from genmf_mi.core.files import write_text
from genmf_mi.core.frame import Frame
from genmf_mi.mesh import solid
from genmf_mi.render import variant
from genmf_mi.stress.fem.settings import Settings
from genmf_mi.stress.fem.simulation import Simulation
from genmf_mi.stress.fem.statistics import weighted_percentiles
from genmf_mi.stress.report import verification
from genmf_mi.stress.report.comparison import layer_ratio

ASSETS = ("hunyuan_bus", "sf3d_raccoon")
CAPS_MM = (1.0, 2.0, 4.0, 10.0)
ROUTES = ("mesh", "field")
WEIGHTS = {
    "ours": (),
    "paper": ("--ssim", "0", "--gradient-ssim", "0", "--teacher-depth", "0", "--alignment", "paper", "--grain", "0"),
}
"""Those of the paper weigh the appearance without what holds plain areas."""
STAGES = {"without": ("--no-stress",), "with": ("--stress",)}
AWAY = 3.0
"""Clamp heights above the bed from where on the maximum counts as ``away``."""
FIGURE = record.FOLDER.parents[1] / "docs" / "stress_regime.png"
ROW = "regime.json"
"""Where a run keeps its figures, so that a benchmark that was ended goes on."""
PAPER = (1 / 0.77, 1 / 0.63)
"""By how much the relief of the paper must have raised the maximum at least, if its constraint took all of that back
(Shen et al., ablation)."""


def main(
    inputs: Inputs,
    *,
    caps_mm: tuple[float, ...] = CAPS_MM,
    routes: tuple[str, ...] = ROUTES,
    terms: tuple[str, ...] = tuple(WEIGHTS),
    new: bool = True,
) -> None:
    """Refine with every cap, route and set of weights, with and without the stage, simulate, and draw a figure.

    Args:
        inputs: What all benchmarks have in common; this one reads --assets.
        caps_mm: On the relief.
        routes: mesh, field or both.
        terms: Weights of the losses: ours, paper or both.
        new: Make runs that are missing; otherwise tabulate those there are.
    """
    variant.use("auto")
    rows = []
    for path in inputs.asset_files(ASSETS):
        for route in routes:
            before: Simulation | None = None
            for kind in terms:
                for cap in caps_mm:
                    for stage, words in STAGES.items():
                        folder = inputs.out / "stress_regime" / f"{path.stem}_{route}_{kind}_{cap:g}_{stage}"
                        if not new and not (folder / ROW).exists():
                            continue
                        source, more = source_of(path, route, folder.parent)
                        options = (*more, *words, *WEIGHTS[kind], "--max-relief-mm", f"{cap:g}")
                        metrics = refined(source, folder, *options)
                        if metrics is None:
                            continue
                        if not (folder / ROW).exists():
                            before = before or untouched(path)
                            after = simulated(*refined_shape(folder, before.frame), before.frame)
                            write_text(folder / ROW, json.dumps(figures(before, after, metrics)))
                        row = {"asset": path.stem, "route": route, "weights": kind, "cap_mm": cap, "stage": stage}
                        rows.append(row | json.loads((folder / ROW).read_text(encoding="utf-8")))
                        print(rows[-1], flush=True)
    record.write("stress_regime", {"samples_per_axis": SAMPLES, "assets": rows})
    if rows:
        draw(rows, FIGURE)


def source_of(asset: Path, route: str, folder: Path) -> tuple[Path, tuple[str | Path, ...]]:
    """The file to refine, and the arguments that it needs. The field is in the coordinates of the asset."""
    if route == "mesh":
        return asset, ()
    return field_of(asset, folder / f"{asset.stem}.npz"), ("--textured", asset)


def untouched(path: Path) -> Simulation:
    """The part before any relief."""
    asset = sources.load(path)
    assert not isinstance(asset, SdfAsset)
    body = solid.solidify(asset.name, asset.vertices, asset.matter)
    frame = Frame.of(body.vertices, PRESETS["default"].size_mm)
    return simulated(frame.normalise(body.vertices), body.faces, frame)


def simulated(vertices: np.ndarray, faces: np.ndarray, frame: Frame) -> Simulation:
    """By fine elements, of a surface in the normalised frame."""
    return verification.simulated(vertices, faces, frame, Settings(size_mm=frame.size_mm, edge_mm=verification.EDGE_MM))


def figures(before: Simulation, after: Simulation, metrics: dict) -> dict:
    """Ratios of maximum (p99.9), mean and surface layer, and of the maximum away from the clamp; LPIPS and relief."""
    one, two = summarised(before), summarised(after)
    return {
        "ratio": {name: round(two[name] / one[name], 4) for name in one}
        | {"surface_layer": round(layer_ratio(before, after) or np.nan, 4)},
        "lpips": [round(metrics[shape]["lpips_alex"], 4) for shape in ("before", "after")],
        "relief_mm": {key: round(value, 3) for key, value in metrics["relief_mm"].items()},
        "plain_p95_mm": round((metrics.get("plain_distortion_mm") or {}).get("p95", np.nan), 3),
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


def draw(rows: list[dict], path: Path) -> None:
    """Ratios over the mean relief, a panel per measure; hollow with the stage, grey what the paper's table needs."""
    from matplotlib.figure import Figure

    panels = {"max": "max (p99.9)", "max_away": "max away from the clamp", "surface_layer": "surface layer, mean"}
    figure = Figure(figsize=(11, 3.8), layout="constrained")
    kinds = sorted({(row["route"], row["weights"]) for row in rows})
    for axes, (key, title) in zip(np.ravel(figure.subplots(1, len(panels))), panels.items(), strict=True):
        if key == "max":
            axes.axhspan(*PAPER, color="0.9", label="the paper's table would need")
        for i, (route, kind) in enumerate(kinds):
            for stage, fill in (("without", f"C{i}"), ("with", "none")):
                chosen = [r for r in rows if (r["route"], r["weights"], r["stage"]) == (route, kind, stage)]
                x, y = ([r["relief_mm"]["mean"] for r in chosen], [r["ratio"][key] for r in chosen])
                label = f"{route}, {kind} weights" if stage == "without" else None
                axes.scatter(x, y, 36, facecolors=fill, edgecolors=f"C{i}", label=label)
        axes.axhline(1, color="0.6", linewidth=0.8)
        axes.set_title(title, loc="left", fontsize=10)
        axes.set_xlabel("mean relief, mm (hollow: with the stage)", fontsize=9)
    figure.axes[0].set_ylabel("stress over that of the part before", fontsize=9)
    figure.axes[0].legend(fontsize=8, frameon=False)
    figure.savefig(path, dpi=110)

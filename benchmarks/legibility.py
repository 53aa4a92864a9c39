"""How well small letters, eyes and a fine drawing can be read on the part: the bundled plaque, seen from the front.

For each motif the render of the part, as it is lit and without any alignment, is correlated with the ink of the drawing
(normalised cross-correlation, both without what is broader than 4 mm). Ink is dark, so that 1 is a part as legible as
the texture; 0 is a part that shows nothing. No optical character recognition is involved.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter

import genmf_mi
from benchmarks import record
from benchmarks.inputs import Inputs
from genmf_mi.assets import samples
from genmf_mi.assets.asset import load
from genmf_mi.assets.samples import plaque
from genmf_mi.core.config import PRESETS
from genmf_mi.render import bridge, scene_file, target, variant
from genmf_mi.render import scene as scenes
from genmf_mi.render.scene import RenderSettings
from genmf_mi.render.view import View, project

VIEWS = View(0, 0), View(28, 12), View(-28, 12)
RESOLUTION, SAMPLES, BROAD_MM = 1024, 16, 4.0


def main(inputs: Inputs) -> None:
    """Refine the plaque in the presets draft and default without the stress stage, and read it.

    Args:
        inputs: What all benchmarks have in common; this one needs none of them.
    """
    rows = {}
    for name, settings in (("draft", PRESETS["draft"]), ("default", PRESETS["default"])):
        for method in ("displacement", "relief"):
            config = replace(settings, stress=False, method=method)
            result = genmf_mi.refine("plaque", config)
            rows[f"{name}, {method}"] = legibility(result.vertices, result.faces)
            print(name, method, rows[f"{name}, {method}"], flush=True)
    record.write("legibility", rows)


def legibility(vertices: np.ndarray, faces: np.ndarray) -> dict[str, float]:
    """The correlation of each motif, the mean of :data:`VIEWS`, of a refined plaque in the units of the sample."""
    variant.use("auto")
    asset = load(samples.resolve("plaque"))
    radius = float(np.linalg.norm(asset.vertices, axis=1).max())
    settings = RenderSettings(radius, RESOLUTION, SAMPLES)
    xml = scene_file.find("plaque")
    with tempfile.TemporaryDirectory(prefix="genmf-") as name:
        folder = Path(name)
        normals = bridge.write_ply(folder / "plain.ply", asset.vertices, asset.faces)
        reference = target.build_reference(
            xml, folder, asset.vertices, asset.faces, normals, asset.closest_albedo, settings
        )
        bridge.write_ply(folder / "part.ply", vertices, faces)
        part = scenes.load(xml, folder / "part.ply", radius=radius, resolution=RESOLUTION, samples=SAMPLES)
        scores = dict.fromkeys(plaque.REGIONS, 0.0)
        for view in VIEWS:
            ink = reference.render([view]).grey[0, 0].numpy()
            shown = bridge.render(part, [view]).grey[0, 0].numpy()
            for motif, (left, bottom, right, top) in plaque.REGIONS.items():
                corners = np.array([(x, y, 13.0) for x in (left, right) for y in (bottom, top)]) / 100
                place = project(corners, view, part.distance, part.half_width) + 0.5
                (x0, y0), (x1, y1) = (np.rint(RESOLUTION * f(place, axis=0)).astype(int) for f in (np.min, np.max))
                scores[motif] += correlation(ink[y0:y1, x0:x1], shown[y0:y1, x0:x1], part) / len(VIEWS)
    return {motif: round(score, 3) for motif, score in scores.items()}


def correlation(a: np.ndarray, b: np.ndarray, scene: scenes.Scene) -> float:
    """Normalised cross-correlation of two images without what is broader than :data:`BROAD_MM`."""
    pixel_mm = 100 * 2 * scene.half_width * scene.distance / RESOLUTION
    a, b = (x - gaussian_filter(x, BROAD_MM / pixel_mm, mode="nearest") for x in (a, b))
    return float((a * b).sum() / np.sqrt((a * a).sum() * (b * b).sum() + 1e-12))

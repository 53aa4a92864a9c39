"""Milliseconds per view, forward and backward to the vertices, beside stock Mitsuba in the same run.

The same icosphere with bumps, the same camera and film, 4 samples per pixel. ``prb`` and ``direct_projective`` render
a ``diffuse`` object under two directional lights at depth 2, which is the nearest that stock plugins come to the
two-light model. An iteration is what the refinement does: new vertices, update of the scene, one view, gradient of the
mean of the image. The integrators take turns, and the median of the rounds counts, so that the ratios hold on a busy
machine.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import torch
import trimesh

from benchmarks import record
from benchmarks.inputs import Inputs
from genmf_mi.core.timer import Timer
from genmf_mi.render import bridge, variant
from genmf_mi.render import scene as scenes
from genmf_mi.render.scene import Scene
from genmf_mi.render.scene_file import find
from genmf_mi.render.view import View, camera_to_world

FACES, RESOLUTIONS, ROUNDS, SAMPLES = (20_480, 81_920, 327_680), (256, 512), 7, 4
WARM_UP = 2
"""Rounds that compile the kernels and do not count."""
VIEW = View(20, 15)


def main(inputs: Inputs) -> None:
    """Time our integrator and two of Mitsuba's on three meshes and at two resolutions.

    Args:
        inputs: What all benchmarks have in common; this one reads none of them.
    """
    variant.use("cpu")
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for count in FACES:
            sphere = trimesh.creation.icosphere(round(np.log(count / 20) / np.log(4)), 0.9)
            points = sphere.vertices * (1 + 0.02 * np.sin(20 * sphere.vertices).prod(axis=1, keepdims=True))
            ply = Path(folder) / "bumpy.ply"
            bridge.write_ply(ply, points, sphere.faces)
            for resolution in RESOLUTIONS:
                rows.append({"faces": len(sphere.faces), "resolution": resolution, **row(ply, points, resolution)})
                print(rows[-1], flush=True)
    record.write("rendering", rows)


def row(ply: Path, points: np.ndarray, resolution: int) -> dict[str, float]:
    """Median milliseconds of each integrator and the ratios; ``points [V,3]`` are the vertices of the file ``ply``."""
    scene = scenes.load(find("default"), ply, radius=0.95, resolution=resolution, samples=SAMPLES)
    iterations = {
        "monochrome": own_iteration(scene, points),
        "prb": stock_iteration("prb", str(ply), scene, resolution),
        "direct_projective": stock_iteration("direct_projective", str(ply), scene, resolution),
    }
    milliseconds: dict[str, list[float]] = {name: [] for name in iterations}
    for turn in range(WARM_UP + ROUNDS):
        for name, iterate in iterations.items():
            timer = Timer()
            iterate()
            if turn >= WARM_UP:
                milliseconds[name].append(1000 * timer.total)

    def ratio(name: str) -> float:
        return round(float(np.median(np.divide(milliseconds["monochrome"], milliseconds[name]))), 3)

    return {
        **{f"{name}_ms": round(float(np.median(times)), 1) for name, times in milliseconds.items()},
        "ratio_to_prb": ratio("prb"),
        "ratio_to_projective": ratio("direct_projective"),
    }


def own_iteration(scene: Scene, points: np.ndarray) -> Callable[[], float]:
    """An iteration of the refinement's renderer; returning a number makes sure that all has been evaluated."""
    start = torch.as_tensor(points, dtype=torch.float32)

    def iterate() -> float:
        vertices = start.clone().requires_grad_(True)
        bridge.render(scene, [VIEW], vertices, seed=0).grey.mean().backward()
        assert vertices.grad is not None
        return float(vertices.grad.abs().sum())

    return iterate


def stock_iteration(integrator: str, ply: str, like: Scene, resolution: int) -> Callable[[], float]:
    """The same with plugins of Mitsuba alone, at the distance of the camera of the scene ``like``."""
    scene: Any = mi.load_dict(stock_scene(integrator, ply, like.distance, resolution))
    params: Any = mi.traverse(scene)
    start = mi.Float(params["object.vertex_positions"])

    def iterate() -> float:
        positions = mi.Float(start)
        dr.enable_grad(positions)
        params["object.vertex_positions"] = positions
        params.update()
        image = mi.render(scene, params, spp=SAMPLES, seed=mi.UInt32(0))
        dr.backward(dr.mean(image, axis=None))
        return float(dr.sum(dr.abs(dr.grad(positions)))[0])

    return iterate


def stock_scene(integrator: str, ply: str, distance: float, resolution: int) -> dict:
    """A scene for ``mi.load_dict``."""
    to_world = mi.ScalarTransform4f(camera_to_world(VIEW, distance))
    lights = {
        f"light_{i}": {"type": "directional", "direction": [-x for x in direction], "irradiance": weight}
        for i, (direction, weight) in enumerate((([-0.4, 0.5, 1.0], 0.75), ([0.8, 0.1, 0.6], 0.25)))
    }
    settings = {"max_depth": 2} if integrator == "prb" else {"sppi": 0}
    film = {"type": "hdrfilm", "width": resolution, "height": resolution, "pixel_format": "luminance"}
    return {
        "type": "scene",
        "integrator": {"type": integrator, **settings},
        **lights,
        "camera": {
            "type": "perspective",
            "fov": 28,
            "to_world": to_world,
            "film": {**film, "rfilter": {"type": "box"}},
            "sampler": {"type": "multijitter", "sample_count": SAMPLES},
        },
        "object": {"type": "ply", "filename": ply, "bsdf": {"type": "diffuse", "reflectance": 0.8}},
    }

"""Milliseconds per view, forward and backward to the vertices, beside stock Mitsuba in the same run.

The same icosphere with bumps, the same camera and film, 4 samples per pixel. ``prb`` and ``direct_projective`` render
a ``diffuse`` object under two directional lights at depth 2, which is the nearest that stock plugins come to the
two-light model. An iteration is what the
refinement does: new vertices, update of the scene, one view, gradient of the mean of the image. The variants take
turns, and the median of the rounds counts, so that the ratios hold on a busy machine.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks import record

FACES, RESOLUTIONS, ROUNDS, SAMPLES = (20_480, 81_920, 327_680), (256, 512), 7, 4


def main() -> None:
    import drjit as dr
    import mitsuba as mi
    import torch
    import trimesh

    from genmf_mi.render import bridge, variant
    from genmf_mi.render import scene as scenes
    from genmf_mi.render.scene import View

    variant.use("cpu")
    view, rows = View(20, 15), []
    with tempfile.TemporaryDirectory() as folder:
        for faces in FACES:
            sphere = trimesh.creation.icosphere(round(np.log(faces / 20) / np.log(4)), 0.9)
            points = sphere.vertices * (1 + 0.02 * np.sin(20 * sphere.vertices).prod(axis=1, keepdims=True))
            ply = Path(folder) / "bumpy.ply"
            bridge.write_ply(ply, points, sphere.faces)
            for resolution in RESOLUTIONS:
                ours = scenes.load(scenes.find("default"), ply, radius=0.95, resolution=resolution, samples=SAMPLES)
                start = torch.as_tensor(points, dtype=torch.float32)

                def step_ours(ours=ours, start=start):
                    vertices = start.clone().requires_grad_(True)
                    bridge.render(ours, [view], vertices, seed=0).grey.mean().backward()
                    return float(vertices.grad.abs().sum())

                def stock(integrator, ours=ours, resolution=resolution, ply=ply):
                    scene = mi.load_dict(_stock_scene(mi, integrator, str(ply), ours, view, resolution))
                    params = mi.traverse(scene)
                    base = mi.Float(params["object.vertex_positions"])

                    def step():
                        positions = mi.Float(base)
                        dr.enable_grad(positions)
                        params["object.vertex_positions"] = positions
                        params.update()
                        dr.backward(dr.mean(mi.render(scene, params, spp=SAMPLES, seed=0), axis=None))
                        return float(dr.sum(dr.abs(dr.grad(positions)))[0])

                    return step

                steps = {"monochrome": step_ours, "prb": stock("prb"), "direct_projective": stock("direct_projective")}
                times: dict[str, list[float]] = {name: [] for name in steps}
                for turn in range(ROUNDS + 2):
                    for name, run in steps.items():
                        began = time.perf_counter()
                        run()
                        if turn >= 2:  # the first rounds compile
                            times[name].append(1000 * (time.perf_counter() - began))
                row = {
                    "faces": len(sphere.faces),
                    "resolution": resolution,
                    **{f"{name}_ms": round(float(np.median(t)), 1) for name, t in times.items()},
                }
                row["ratio_to_prb"] = round(float(np.median(np.divide(times["monochrome"], times["prb"]))), 3)
                row["ratio_to_projective"] = round(
                    float(np.median(np.divide(times["monochrome"], times["direct_projective"]))), 3
                )
                print(row, flush=True)
                rows.append(row)
    record.write("rendering", rows)


def _stock_scene(mi, integrator: str, ply: str, ours, view, resolution: int) -> dict:
    from genmf_mi.render.scene import camera_to_world

    to_world = mi.ScalarTransform4f(camera_to_world(view, ours.distance))
    lights = {
        f"light_{i}": {"type": "directional", "direction": [-x for x in direction], "irradiance": weight}
        for i, (direction, weight) in enumerate((([-0.4, 0.5, 1.0], 0.75), ([0.8, 0.1, 0.6], 0.25)))
    }
    settings = {"max_depth": 2} if integrator == "prb" else {"sppi": 0}
    return {
        "type": "scene",
        "integrator": {"type": integrator, **settings},
        **lights,
        "camera": {
            "type": "perspective",
            "fov": 28,
            "to_world": to_world,
            "film": {
                "type": "hdrfilm",
                "width": resolution,
                "height": resolution,
                "pixel_format": "luminance",
                "rfilter": {"type": "box"},
            },
            "sampler": {"type": "multijitter", "sample_count": SAMPLES},
        },
        "object": {"type": "ply", "filename": ply, "bsdf": {"type": "diffuse", "reflectance": 0.8}},
    }

"""Light with shadows: a part under two soft lamps and a dim sky, by path tracing.

``twolight`` knows no shadows, so a groove is as bright in it as its walls are steep. A print on a desk has them.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Float32
from numpy import ndarray
from torch import Tensor

from genmf_mi.render import variant
from genmf_mi.render.scene import Scene
from genmf_mi.render.untyped import MitsubaObject, MitsubaScene, mi
from genmf_mi.render.view import View, camera_to_world, image_axes, light_rotation

RADIUS = np.radians(12.0)
"""Of the disc that a lamp covers in the sky."""
SKY = 0.35
"""Share of the light that comes from everywhere, on a surface that faces all of it."""
BOUNCES = 3
"""Path vertices after the camera: what a surface receives from the lamps, and once from its surroundings."""
SAMPLER = "multijitter"
"""Two thirds of the noise of independent samples."""
_HEIGHT = 64
"""Rows of the picture of the sky."""


@dataclass(frozen=True)
class Lighting:
    """What a studio takes over from a scene, which itself need not be kept.

    distance, fov: of the camera, normalised units and degrees. albedo: of the part.
    sky: radiance by direction, in the frame of the lights, which travel with the camera.
    """

    distance: float
    fov: float
    albedo: float
    sky: Float32[ndarray, "H W 3"]

    @classmethod
    def of(cls, scene: Scene) -> Lighting:
        """Lamps in the directions of the key and the fill light of ``scene``."""
        return cls(scene.distance, scene.fov, scene.material["albedo"], _sky(scene))


class Studio:
    """The mesh in ``ply`` under lamps.

    Args:
        resolution, samples: pixels per side, and rays per pixel.
    """

    def __init__(self, lighting: Lighting, ply: str | Path, resolution: int, samples: int) -> None:
        self._distance, self._samples = lighting.distance, samples
        self._scene: MitsubaScene = mi.load_dict({
            "type": "scene",
            "integrator": {"type": "path", "max_depth": BOUNCES, "hide_emitters": True},
            "sky": {"type": "envmap", "bitmap": mi.Bitmap(lighting.sky)},
            "sensor": {
                "type": "perspective", "fov": lighting.fov,
                "film": {"type": "hdrfilm", "width": resolution, "height": resolution, "pixel_format": "luminance",
                         "rfilter": {"type": "box"}},
                "sampler": {"type": SAMPLER, "sample_count": samples},
            },
            "part": {
                "type": "ply", "filename": str(ply),
                "bsdf": {"type": "diffuse", "reflectance": {"type": "uniform", "value": lighting.albedo}},
            },
        })  # fmt: skip
        self._params: MitsubaObject = mi.traverse(self._scene)

    def render(self, view: View, seed: int = 0) -> Float[Tensor, "1 1 H W"]:
        """Grey values ``[1,1,H,W]``, linear, weighted by the coverage."""
        pose, turn = camera_to_world(view, self._distance), np.eye(4)
        # The sky is given in the frame of the lights: x to the right, y up, z towards the viewer
        turn[:3, :3] = image_axes(view) @ light_rotation(view)
        self._params[variant.camera_pose_key("sensor")] = mi.Transform4f(pose)
        self._params["sky.to_world"] = mi.Transform4f(turn)
        self._params.update()
        image = mi.render(self._scene, seed=seed, spp=self._samples).torch()
        return image.permute(2, 0, 1)[None, :1]


def _sky(scene: Scene) -> Float32[ndarray, "H W 3"]:
    """Radiance by direction, so that a surface that faces the key light alone gets about its weight."""
    # Mitsuba: u = atan2(x, -z) / 2π, v = acos(y) / π
    rows, columns = (np.arange(_HEIGHT) + 0.5) / _HEIGHT, (np.arange(2 * _HEIGHT) + 0.5) / (2 * _HEIGHT)
    polar, around = np.meshgrid(rows * np.pi, columns * 2 * np.pi, indexing="ij")
    towards = np.stack([np.sin(polar) * np.sin(around), np.cos(polar), -np.sin(polar) * np.cos(around)], axis=-1)
    radiance = np.full(towards.shape[:2], SKY / np.pi)
    for key, weight in scene.light_weights.items():
        direction = scene.lights[key]
        inside = towards @ (direction / np.linalg.norm(direction)) > np.cos(RADIUS)
        solid_angle = float((np.sin(polar) * inside).sum() * np.pi / _HEIGHT * np.pi / _HEIGHT)
        radiance += np.where(inside, (1 - SKY) * weight / max(solid_angle, 1e-6), 0)
    return np.repeat(radiance[..., None], 3, axis=-1).astype(np.float32)

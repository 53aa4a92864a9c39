"""The formula of ``twolight`` in NumPy, and small scenes that the tests of the plugins share."""

from __future__ import annotations

import mitsuba as mi
import numpy as np

AXES = np.eye(3)
KEY, FILL = np.array([-0.4, 0.5, 1.0]), np.array([0.8, 0.1, 0.6])
DISTANCE, FOV = 5.0, 40.0


def phi(x: np.ndarray, sharpness: float) -> np.ndarray:
    return np.logaddexp(0, sharpness * x) / np.logaddexp(0, sharpness)


def grey(
    normals: np.ndarray,
    axes: np.ndarray = AXES,
    *,
    albedo=0.8,
    ambient=0.2,
    key=KEY,
    fill=FILL,
    key_weight=0.75,
    fill_weight=0.25,
    sharpness=8.0,
) -> np.ndarray:
    """G as `twolight` documents it; the columns of ``axes`` are right, up and towards the viewer."""
    lit = sum(
        weight * phi(normals @ (axes @ (light / np.linalg.norm(light))), sharpness)
        for weight, light in ((key_weight, key), (fill_weight, fill))
    )
    return albedo * (ambient + (1 - ambient) * lit)


def camera(azimuth: float = 0, elevation: float = 0) -> tuple[np.ndarray, np.ndarray]:
    """Where the camera is, and the columns right, up, towards the viewer, from spherical coordinates."""
    a, e = np.radians([azimuth, elevation])
    back = np.array([np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)])
    right = np.cross([0, 1, 0], back)
    right /= np.linalg.norm(right)
    return DISTANCE * back, np.stack([right, np.cross(back, right), back], axis=1)


def transform(azimuth: float = 0, elevation: float = 0):
    origin, axes = camera(azimuth, elevation)
    return mi.ScalarTransform4f().look_at(origin=origin.tolist(), target=[0, 0, 0], up=axes[:, 1].tolist())


def sensor(azimuth: float = 0, elevation: float = 0, *, resolution=32, samples=1, sampler="independent") -> dict:
    return {
        "type": "perspective", "fov": FOV, "to_world": transform(azimuth, elevation),
        "sampler": {"type": sampler, "sample_count": samples},
        "film": {"type": "hdrfilm", "width": resolution, "height": resolution, "rfilter": {"type": "box"},
                 "pixel_format": "luminance"},
    }  # fmt: skip


def ball(material: dict | None = None, integrator: dict | None = None, **camera):
    return mi.load_dict({
        "type": "scene", "integrator": {"type": "monochrome", **(integrator or {})}, "sensor": sensor(**camera),
        "ball": {"type": "sphere", "material": {"type": "twolight", **(material or {})}},
    })  # fmt: skip


def image(scene, **options) -> np.ndarray:
    return np.array(mi.render(scene, **options), dtype=np.float64)


def properties(bsdf: dict):
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(bsdf)
    return properties


PARAMETERS = ("albedo.value", "ambient", "key", "fill", "key_weight", "fill_weight", "sharpness")

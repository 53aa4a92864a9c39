"""Shapes that the tests of the renderer share."""

from __future__ import annotations

import numpy as np
import trimesh

from genmf_mi.render import bridge, scene


def lumpy(directions: np.ndarray) -> np.ndarray:
    """A shape without symmetry, around unit ``directions``."""
    x, y, z = directions.T
    return directions * (0.75 + 0.12 * np.sin(3 * x + 1) * np.cos(4 * y) + 0.05 * z * x)[:, None]


def seamless() -> tuple[np.ndarray, np.ndarray]:
    ball = trimesh.creation.icosphere(4)
    return lumpy(ball.vertices), np.asarray(ball.faces)


def loaded(folder, vertices: np.ndarray, faces: np.ndarray, **options) -> scene.Scene:
    bridge.write_ply(folder / "part.ply", vertices, faces)
    return scene.load(
        scene.find("default"),
        folder / "part.ply",
        radius=float(np.linalg.norm(vertices, axis=1).max()),
        **{"resolution": 96, "samples": 16, **options},
    )

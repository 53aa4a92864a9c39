"""Small shapes that several tests use: a painted egg, as a mesh and as files; a sphere; noise."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh


def egg() -> trimesh.Trimesh:
    """Closed, with 1280 faces and no colours."""
    ball = trimesh.creation.icosphere(3)
    return trimesh.Trimesh(ball.vertices * (1, 0.8, 0.9), ball.faces, process=False)


def painted(path: str | Path) -> str:
    """Write the egg with stripes, in the format of the suffix; returns the path."""
    mesh = egg()
    bright = np.sin(9 * mesh.vertices[:, 1]) > 0
    mesh.visual.vertex_colors = np.where(bright[:, None], (220, 120, 120, 255), (60, 60, 60, 255)).astype(np.uint8)
    mesh.export(path)
    return str(path)


def sphere(subdivisions: int = 3, radius: float = 1.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, faces and exact normals."""
    ball = trimesh.creation.icosphere(subdivisions)
    directions = np.array(ball.vertices)
    return radius * directions, np.array(ball.faces), directions


def noise(*shape: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(shape)


def stripes(points: np.ndarray) -> np.ndarray:
    """Linear RGB ``[N,3]`` of a striped object."""
    return np.where(np.sin(10 * points[:, 1:2] + 3 * points[:, :1]) > 0, np.float32([0.8, 0.2, 0.2]), np.float32(0.15))

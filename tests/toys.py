"""A small painted egg, as a mesh and as files."""

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

"""A small ball with a texture: large letters are not needed where a checkerboard does."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh
from PIL import Image


def checkered_ball(path: str | Path, squares: int = 8, rows: int = 24) -> Path:
    """Write a ball of radius 1 with a checkerboard of two colours, in the format of the suffix; returns the path.

    rows: of its faces from pole to pole.
    """
    columns = 2 * rows
    polar, turn = np.meshgrid(np.linspace(0, 1, rows + 1), np.linspace(0, 1, columns + 1), indexing="ij")
    p, t = np.pi * polar.ravel(), 2 * np.pi * turn.ravel()
    vertices = np.stack([np.sin(p) * np.sin(t), np.cos(p), np.sin(p) * np.cos(t)], axis=1)
    i, j = (grid.ravel() for grid in np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij"))
    a, b = i * (columns + 1) + j, (i + 1) * (columns + 1) + j
    upper, lower = np.stack([a, b, a + 1], 1)[i > 0], np.stack([b, b + 1, a + 1], 1)[(i > 0) & (i < rows - 1)]
    faces = np.concatenate([np.stack([a, b, b + 1], 1)[i == 0], upper, lower])
    odd = np.indices((squares, 2 * squares)).sum(axis=0) % 2
    texture = np.array([[230, 190, 60], [30, 50, 130]], np.uint8)[np.kron(odd, np.ones((16, 16), int))]
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=Image.fromarray(texture))
    uv = np.column_stack([turn.ravel(), 1 - polar.ravel()])
    if Path(path).suffix == ".obj":
        material = material.to_simple()
    visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    trimesh.Trimesh(vertices, faces, visual=visual, process=False).export(path)
    return Path(path)

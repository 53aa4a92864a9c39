"""A shape and given pictures of it, for the tests of references."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh
from PIL import Image


def ball(subdivisions: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """Slightly uneven, so that no symmetry hides a mistake."""
    mesh = trimesh.creation.icosphere(subdivisions)
    directions = np.array(mesh.vertices)
    return directions * (0.85 + 0.1 * np.sin(3 * directions[:, :1] + directions[:, 1:2])), np.array(mesh.faces)


def picture(path: Path, size: tuple[int, int], box: tuple[int, int, int, int], *, mode: str = "RGBA") -> Path:
    """Bluish, with an object at ``box`` (left, top, right, bottom): red in its left half, grey in its right."""
    left, top, right, bottom = box
    pixels = np.full((*size[::-1], 4), (40, 60, 200, 0), np.uint8)
    pixels[top:bottom, left:right] = (128, 128, 128, 255)
    pixels[top:bottom, left : (left + right) // 2] = (255, 20, 20, 255)
    Image.fromarray(pixels).convert(mode).save(path)
    return path

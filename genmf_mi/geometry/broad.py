"""What of a field on the surface is broader than a length."""

from __future__ import annotations

import numpy as np

from genmf_mi.geometry.mesh import Smoother


def broad_smoother(vertices: np.ndarray, faces: np.ndarray, length: float, device: str = "cpu") -> Smoother:
    """Keeps wavelengths well above ``length`` (in the unit of the vertices) of a field on an even mesh, and drops those
    well below: a screened Poisson problem."""
    edges = np.linalg.norm(vertices[faces[:, 1]] - vertices[faces[:, 0]], axis=1)
    return Smoother(faces, len(vertices), smoothing=(length / edges.mean() / 2) ** 2 / 2, device=device)


def broad_part(vertices: np.ndarray, faces: np.ndarray, field: np.ndarray, length: float) -> np.ndarray:
    """What :func:`broad_smoother` keeps of ``field [V]``."""
    import torch

    smoother = broad_smoother(vertices, faces, length)
    return smoother(torch.as_tensor(field, dtype=torch.float32)[:, None])[:, 0].numpy().astype(np.float64)

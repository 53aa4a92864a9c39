"""What of a field on the surface is broader than a length."""

from __future__ import annotations

import numpy as np

from genmf_mi.geometry.mesh import ImplicitDiffusion


def low_pass(vertices: np.ndarray, faces: np.ndarray, length: float, device: str = "cpu") -> ImplicitDiffusion:
    """Keeps wavelengths well above ``length`` (in the unit of the vertices) of a field on an even mesh, and drops those
    well below: a screened Poisson problem."""
    edges = np.linalg.norm(vertices[faces[:, 1]] - vertices[faces[:, 0]], axis=1)
    return ImplicitDiffusion(faces, len(vertices), smoothing=(length / edges.mean() / 2) ** 2 / 2, device=device)


def low_frequency(vertices: np.ndarray, faces: np.ndarray, field: np.ndarray, length: float) -> np.ndarray:
    """What :func:`low_pass` keeps of ``field [V]``."""
    import torch

    smoother = low_pass(vertices, faces, length)
    return smoother(torch.as_tensor(field, dtype=torch.float32)[:, None])[:, 0].numpy().astype(np.float64)

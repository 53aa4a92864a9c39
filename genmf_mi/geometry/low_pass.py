"""The low-frequency component of a field on a surface."""

from __future__ import annotations

import numpy as np
import torch

from genmf_mi.geometry.laplacian import ImplicitDiffusion


def low_pass(vertices: np.ndarray, cells: np.ndarray, wavelength: float, device: str = "cpu") -> ImplicitDiffusion:
    """A filter that keeps wavelengths well above ``wavelength`` and suppresses those well below: screened Poisson.

    Args:
        vertices: ``[V,3]`` of an even mesh or grid.
        cells: its faces ``[F,3]`` or edges ``[E,2]``.
        wavelength: in the unit of the vertices.
    """
    edges = np.linalg.norm(vertices[cells[:, 1]] - vertices[cells[:, 0]], axis=1)
    return ImplicitDiffusion(cells, len(vertices), smoothing=(wavelength / edges.mean() / 2) ** 2 / 2, device=device)


def low_frequency(vertices: np.ndarray, faces: np.ndarray, field: np.ndarray, wavelength: float) -> np.ndarray:
    """What :func:`low_pass` keeps of ``field [V]``."""
    smooth = low_pass(vertices, faces, wavelength)
    return smooth(torch.as_tensor(field, dtype=torch.float32)[:, None])[:, 0].numpy().astype(np.float64)

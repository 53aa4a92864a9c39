"""The low-frequency component of a field on a surface."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from genmf_mi.geometry.laplacian import ImplicitDiffusion, cotangent_laplacian, laplacian
from genmf_mi.mesh.measures import vertex_areas


class LowPass:
    """A filter that keeps wavelengths well above ``wavelength`` and suppresses those well below: screened Poisson,
    (M + tL) x = M u with t = 3/16 of the squared wavelength.

    Args:
        vertices: ``[V,3]`` of a mesh of any density, or of an even grid.
        cells: its faces ``[F,3]`` or edges ``[E,2]``.
        wavelength: in the unit of the vertices.
    """

    def __init__(self, vertices: np.ndarray, cells: np.ndarray, wavelength: float, device: str = "cpu") -> None:
        if cells.shape[1] == 2:
            edges = np.linalg.norm(vertices[cells[:, 1]] - vertices[cells[:, 0]], axis=1)
            stiffness = laplacian(cells, len(vertices)) * ((wavelength / edges.mean() / 2) ** 2 / 2)
            mass = np.ones(len(vertices))
        else:
            mass = vertex_areas(vertices, cells)
            unit = mass.mean()
            stiffness, mass = cotangent_laplacian(vertices, cells) * (3 / 16 * wavelength**2 / unit), mass / unit
        self._solver = ImplicitDiffusion(stiffness, mass, device)
        self._mass = torch.as_tensor(mass, dtype=torch.float32, device=device)[:, None]

    def __call__(self, u: Tensor) -> Tensor:
        """``[V,k]`` to ``[V,k]``."""
        return self._solver(self._mass * u)

    @torch.no_grad()
    def of(self, field: np.ndarray) -> np.ndarray:
        """What it keeps of ``field [V]``, ``float64``."""
        u = torch.as_tensor(field, dtype=torch.float32, device=self._mass.device)
        return self(u[:, None])[:, 0].cpu().numpy().astype(np.float64)


def low_frequency(vertices: np.ndarray, faces: np.ndarray, field: np.ndarray, wavelength: float) -> np.ndarray:
    """What :class:`LowPass` keeps of ``field [V]``."""
    return LowPass(vertices, faces, wavelength).of(field)

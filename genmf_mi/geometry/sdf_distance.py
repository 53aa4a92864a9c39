"""A generator's field near its surface: its slope, its free weights, and the distance it stands for."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from scipy.ndimage import gaussian_filter
from torch import Tensor

from genmf_mi.assets.sdf_asset import SdfAsset
from genmf_mi.sdf.distance import signed_distance
from genmf_mi.sdf.flexicubes import WEIGHTS

LOWEST_SLOPE, STEEPEST_SLOPE = 0.25, 4.0
"""Bounds of the slope of a field."""
AVERAGED_CELLS = 2.0
"""Cells over which slopes are averaged (standard deviation)."""


def slope(phi: np.ndarray, samples: np.ndarray, distance: np.ndarray) -> np.ndarray:
    """The change of ``phi`` per unit of distance from its surface, 1 for a signed distance: ``[N]``, smooth.

    The mean of |Φ| over distance about each sample, weighted by the square of the distance: close to the surface both
    are about 0.

    Args:
        phi: ``[m,m,m]``. samples: ``[N]`` indices into the flattened grid. distance: ``[N]`` of these to the surface.
    """
    weighted, weight = np.zeros(phi.size), np.zeros(phi.size)
    weighted[samples], weight[samples] = np.abs(phi.reshape(-1)[samples]) * distance, distance**2
    weighted, weight = (
        gaussian_filter(x.reshape(phi.shape), AVERAGED_CELLS).reshape(-1)[samples] for x in (weighted, weight)
    )
    return np.clip(weighted / np.maximum(weight, 1e-12), LOWEST_SLOPE, STEEPEST_SLOPE)


def free_weights(asset: SdfAsset, cubes: np.ndarray) -> np.ndarray:
    """Free weights ``[K,21]`` of the ``cubes [K]``, zeros where the generator gave none."""
    if asset.weights is None:
        return np.zeros((len(cubes), WEIGHTS), np.float32)
    if asset.rows is None:
        return asset.weights[cubes]
    row = asset.rows[cubes]
    return np.where(row[:, None] >= 0, asset.weights[row], np.float32(0))


def sampled(field: Tensor, places: Tensor) -> Tensor:
    """``field [m,m,m]`` on [-1, 1]³ at ``places [...,3]``, linear in between, 0 outside: ``[...]``, differentiable."""
    # grid_sample names the last axis first
    at = places.flip(-1).reshape(1, -1, 1, 1, 3)
    values = torch.nn.functional.grid_sample(field[None, None], at, align_corners=True, padding_mode="zeros")
    return values.reshape(places.shape[:-1])


class SdfDistance:
    """Φ in the normalised frame on the grid of the stress prediction, from a generator's Φ on its own grid.

    The exact distance to the initial surface, and what the field has sunk by since. Where the field is a distance on
    the same grid, this is the field itself.

    Args:
        sunk: from ``phi [m,m,m]`` to by how much its surface has sunk, ``[m,m,m]`` in normalised units.
        surface: vertices ``[V,3]``, normalised frame, and faces ``[F,3]`` of the initial surface.
        n: samples per axis of the result.
        scale, shift: normalised frame = grid units · scale + shift ``[3]``.
        device: of the result.
    """

    def __init__(
        self,
        sunk: Callable[[Tensor], Tensor],
        surface: tuple[np.ndarray, np.ndarray],
        n: int,
        *,
        scale: float,
        shift: np.ndarray,
        device: str,
    ) -> None:
        self._sunk = sunk
        like = {"dtype": torch.float32, "device": device}
        self._distance = torch.as_tensor(signed_distance(*surface, n), **like)
        axes = [(np.linspace(-1, 1, n) - offset) / scale for offset in shift]
        self._places = torch.as_tensor(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1), **like)

    def __call__(self, phi: Tensor) -> Tensor:
        """``[1,n,n,n]``, negative inside, for ``phi [m,m,m]``; linear in it."""
        return (self._distance + sampled(self._sunk(phi), self._places))[None]

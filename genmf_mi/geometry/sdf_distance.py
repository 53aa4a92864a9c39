"""A generator's field near its surface: how steep it is, and what distance it stands for."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch
from scipy.ndimage import gaussian_filter
from torch import Tensor

from genmf_mi.sdf.distance import signed_distance
from genmf_mi.sdf.flexicubes import WEIGHTS

if TYPE_CHECKING:
    from genmf_mi.assets.sdf_asset import SdfAsset
    from genmf_mi.geometry.sdf import SdfParameterization

LEAST, STEEPEST = 0.25, 4.0
"""What a slope is taken to be at least and at most."""
AROUND = 2.0
"""Cells over which slopes are averaged (standard deviation)."""


def slope(phi: np.ndarray, samples: np.ndarray, distance: np.ndarray) -> np.ndarray:
    """By how much ``phi`` differs per unit of distance from its surface, 1 for a distance: ``[N]``, smooth.

    phi: ``[m,m,m]``. samples: ``[N]`` indices into the flattened grid, and their distance ``[N]`` to the surface.
    A mean of |Φ| over distance about each sample, weighted by the square of the distance: close by, both are about 0.
    """
    over, under = np.zeros(phi.size), np.zeros(phi.size)
    over[samples], under[samples] = np.abs(phi.reshape(-1)[samples]) * distance, distance**2
    over, under = (gaussian_filter(x.reshape(phi.shape), AROUND).reshape(-1)[samples] for x in (over, under))
    return np.clip(over / np.maximum(under, 1e-12), LEAST, STEEPEST)


def weights_of(asset: SdfAsset, cubes: np.ndarray) -> np.ndarray:
    """Free weights ``[K,21]`` of the ``cubes [K]``, zeros where the generator gave none."""
    if asset.weights is None:
        return np.zeros((len(cubes), WEIGHTS), np.float32)
    if asset.rows is None:
        return asset.weights[cubes]
    row = asset.rows[cubes]
    return np.where(row[:, None] >= 0, asset.weights[row], np.float32(0))


class FieldDistance:
    """Φ in the normalised frame on the grid of the stress network, out of a generator's Φ on its own grid.

    The exact distance to the initial surface, less what the field has been raised by since. Where the field is a
    distance on the same grid, this is the field itself.

    geometry: whose field it is. samples: per axis of the network's grid.
    """

    def __init__(self, geometry: SdfParameterization, samples: int) -> None:
        self.initial, self.samples, self.slope = geometry.initial, geometry.samples, geometry.slope[:, 0]
        like = {"dtype": torch.float32, "device": geometry.device}
        self.rest = torch.as_tensor(signed_distance(geometry.vertices, geometry.faces, samples), **like)
        axes = [(np.linspace(-1, 1, samples) - shift) / geometry.scale for shift in geometry.shift]
        # grid_sample names the last axis first
        self.places = torch.as_tensor(np.stack(np.meshgrid(*axes, indexing="ij")[::-1], axis=-1)[None], **like)

    def __call__(self, phi: Tensor) -> Tensor:
        """``[1,n,n,n]``, negative inside, for ``phi [m,m,m]``; linear in it."""
        change = (phi - self.initial).reshape(-1)[self.samples] / self.slope
        spread = torch.zeros_like(self.initial).reshape(-1).index_copy(0, self.samples, change)
        there = torch.nn.functional.grid_sample(
            spread.view(1, 1, *self.initial.shape), self.places, align_corners=True, padding_mode="zeros"
        )
        return self.rest[None] + there[0]

"""From the nodes of a tetrahedral mesh to the grid that Φ lives on."""

from __future__ import annotations

import numpy as np

from genmf_mi.stress.assembly import P1
from genmf_mi.stress.tetrahedra import TetMesh

_CHUNK = 4_000_000
"""Candidate pairs of a cell and a grid point handled at a time."""


def to_grid(mesh: TetMesh, value: np.ndarray, phi: np.ndarray) -> tuple[np.ndarray, int]:
    """The piecewise linear field ``value [N]`` at the grid points with Φ ≤ 0, zero at the others.

    ``mesh`` is in the normalised frame. The surface of the mesh lies a little inside that of Φ in places, so about one
    inner grid point in a hundred is in no tetrahedron; it takes the value of the nearest one that is.

    Returns:
        float32 of the shape of ``phi``, and how many inner points took a neighbour's value.
    """
    from scipy.ndimage import distance_transform_edt

    n = phi.shape[0]
    scale = (n - 1) / 2.0
    points = (mesh.points + 1.0) * scale
    elements = P1(mesh.moved(points))
    corner = points[mesh.cells]
    low = np.ceil(corner.min(axis=1) - 1e-9).astype(np.int64).clip(0)
    high = np.floor(corner.max(axis=1) + 1e-9).astype(np.int64).clip(max=n - 1)
    extent = (high - low + 1).clip(0)
    count = extent.prod(axis=1)

    result = np.full(n**3, np.nan)
    stops = np.searchsorted(np.cumsum(count), np.arange(_CHUNK, count.sum() + _CHUNK, _CHUNK), side="right")
    for start, stop in zip(np.r_[0, stops[:-1]], stops, strict=True):
        cell = np.repeat(np.arange(start, stop), count[start:stop])
        rank = np.arange(len(cell)) - np.repeat(np.cumsum(count[start:stop]) - count[start:stop], count[start:stop])
        size = extent[cell]
        index = low[cell] + np.stack(
            [rank // (size[:, 1] * size[:, 2]), rank // size[:, 2] % size[:, 1], rank % size[:, 2]], axis=1
        )
        offset = index - corner[cell, 0]
        weight = np.einsum("kai,ki->ka", elements.gradients[cell], offset)
        weight[:, 0] += 1.0
        inside = weight.min(axis=1) >= -1e-9
        chosen = cell[inside]
        target = np.ravel_multi_index(tuple(index[inside].T), (n, n, n))
        result[target] = (weight[inside] * value[mesh.cells[chosen]]).sum(axis=1)

    result = result.reshape(n, n, n)
    inner = phi <= 0
    missing = np.isnan(result)
    filled = int((missing & inner).sum())
    if filled and not missing.all():
        nearest = distance_transform_edt(missing, return_distances=False, return_indices=True)
        result = result[tuple(nearest)]
    return np.where(inner, np.nan_to_num(result), 0.0).astype(np.float32), filled

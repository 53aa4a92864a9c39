"""From the nodes of a tetrahedral mesh to the grid that Φ is sampled on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from genmf_mi.stress.fem.shape_functions import ShapeFunctions
from genmf_mi.stress.fem.tet_mesh import TetMesh

_CHUNK = 4_000_000
"""Candidate pairs of a cell and a grid point handled at a time."""


@dataclass(frozen=True)
class PointLocation:
    """The cells of a mesh that samples of a grid lie in.

    sample: ``[M]``, into the flattened grid. cell: ``[M]``. point: ``[M,3]``, in the normalised frame and in ``cell``.
    weight: ``[M,4]``, barycentric coordinates of ``point`` in ``cell``.
    filled: how many of the samples are in no cell; they have the cell and the point of the nearest sample that is in
    one.
    """

    sample: np.ndarray
    cell: np.ndarray
    point: np.ndarray
    weight: np.ndarray
    filled: int

    def to_grid(self, mesh: TetMesh, value: np.ndarray, n: int) -> np.ndarray:
        """The piecewise linear field ``value [N]`` of ``mesh`` at the samples, zero elsewhere: float32 ``[n,n,n]``."""
        field = np.zeros(n**3, dtype=np.float32)
        field[self.sample] = (self.weight * value[mesh.cells[self.cell]]).sum(axis=1)
        return field.reshape(n, n, n)


def locate_points(mesh: TetMesh, phi: np.ndarray) -> PointLocation:
    """The cells that the grid points with Φ ≤ 0 are in; ``mesh`` is in the normalised frame.

    The surface of the mesh lies a little inside that of Φ in places, so about one inner grid point in a hundred is in
    no tetrahedron; it is taken for the nearest one that is. Nothing is located if no grid point is in a tetrahedron.
    """
    n = phi.shape[0]
    scale = (n - 1) / 2.0
    elements = ShapeFunctions((mesh.points + 1.0) * scale, mesh.cells)
    owner = _owners(elements, n)
    sample = np.flatnonzero(phi <= 0)
    missing = owner < 0
    filled = int(missing[sample].sum())
    if missing.all():
        none = np.zeros(0, dtype=int)
        return PointLocation(none, none, np.zeros((0, 3)), np.zeros((0, 4)), filled)
    source = sample if filled == 0 else _nearest_sample(missing.reshape(n, n, n))[sample]
    cell, index = owner[source], np.stack(np.unravel_index(source, (n, n, n)), axis=1)
    return PointLocation(sample, cell, index / scale - 1.0, elements.barycentric(cell, index.astype(float)), filled)


def _owners(elements: ShapeFunctions[np.ndarray], n: int) -> np.ndarray:
    """A cell that each point of the flattened grid is in, ``[n³]``, -1 for none; nodes in units of grid cells."""
    corner = elements.points[elements.cells]
    low = np.ceil(corner.min(axis=1) - 1e-9).astype(np.int64).clip(0)
    high = np.floor(corner.max(axis=1) + 1e-9).astype(np.int64).clip(max=n - 1)
    extent = (high - low + 1).clip(0)
    count = extent.prod(axis=1)
    owner = np.full(n**3, -1)
    stops = np.searchsorted(np.cumsum(count), np.arange(_CHUNK, count.sum() + _CHUNK, _CHUNK), side="right")
    for start, stop in zip(np.r_[0, stops[:-1]], stops, strict=True):
        # Each cell with each of the grid points in its bounding box
        cell = np.repeat(np.arange(start, stop), count[start:stop])
        rank = np.arange(len(cell)) - np.repeat(np.cumsum(count[start:stop]) - count[start:stop], count[start:stop])
        size = extent[cell]
        index = low[cell] + np.stack(
            [rank // (size[:, 1] * size[:, 2]), rank // size[:, 2] % size[:, 1], rank % size[:, 2]], axis=1
        )
        inside = elements.barycentric(cell, index.astype(float)).min(axis=1) >= -1e-9
        owner[np.ravel_multi_index(tuple(index[inside].T), (n, n, n))] = cell[inside]
    return owner


def _nearest_sample(missing: np.ndarray) -> np.ndarray:
    """For each point of a grid, the nearest one that is not ``missing [n,n,n]``: flat indices ``[n³]``."""
    from scipy.ndimage import distance_transform_edt

    nearest: Any = distance_transform_edt(missing, return_distances=False, return_indices=True)
    return np.ravel_multi_index(tuple(nearest), missing.shape).reshape(-1)


def to_grid(mesh: TetMesh, value: np.ndarray, phi: np.ndarray) -> tuple[np.ndarray, int]:
    """The piecewise linear field ``value [N]`` at the grid points with Φ ≤ 0, zero at the others.

    Returns:
        float32 of the shape of ``phi``, and how many inner points took a neighbour's value, see :func:`locate_points`.
    """
    location = locate_points(mesh, phi)
    return location.to_grid(mesh, value, phi.shape[0]), location.filled

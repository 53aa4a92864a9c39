"""From the nodes of a tetrahedral mesh to the grid that Φ lives on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from genmf_mi.stress.fem.assembly import P1
from genmf_mi.stress.fem.tetrahedra import TetMesh

_CHUNK = 4_000_000
"""Candidate pairs of a cell and a grid point handled at a time."""


@dataclass(frozen=True)
class PointLocation:
    """Where samples of a grid lie in a mesh.

    sample: ``[M]``, into the flattened grid; cell: ``[M]``; point: ``[M,3]``, in the frame of the mesh and in ``cell``;
    weight: ``[M,4]``, its barycentric coordinates there.
    filled: how many of the samples are in no cell and have the cell and the point of the nearest one that is.
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
    no tetrahedron; it is taken for the nearest one that is. Without any that is there are no places.
    """
    from scipy.ndimage import distance_transform_edt

    n = phi.shape[0]
    scale = (n - 1) / 2.0
    points = (mesh.points + 1.0) * scale
    gradients = P1(mesh.moved(points)).gradients
    corner = points[mesh.cells]

    def weights(cell: np.ndarray, index: np.ndarray) -> np.ndarray:
        """Barycentric coordinates ``[K,4]`` of the grid points ``index [K,3]``, each in its ``cell [K]``."""
        weight = np.einsum("kai,ki->ka", gradients[cell], index - corner[cell, 0])
        weight[:, 0] += 1.0
        return weight

    low = np.ceil(corner.min(axis=1) - 1e-9).astype(np.int64).clip(0)
    high = np.floor(corner.max(axis=1) + 1e-9).astype(np.int64).clip(max=n - 1)
    extent = (high - low + 1).clip(0)
    count = extent.prod(axis=1)

    owner = np.full(n**3, -1)
    stops = np.searchsorted(np.cumsum(count), np.arange(_CHUNK, count.sum() + _CHUNK, _CHUNK), side="right")
    for start, stop in zip(np.r_[0, stops[:-1]], stops, strict=True):
        cell = np.repeat(np.arange(start, stop), count[start:stop])
        rank = np.arange(len(cell)) - np.repeat(np.cumsum(count[start:stop]) - count[start:stop], count[start:stop])
        size = extent[cell]
        index = low[cell] + np.stack(
            [rank // (size[:, 1] * size[:, 2]), rank // size[:, 2] % size[:, 1], rank % size[:, 2]], axis=1
        )
        inside = weights(cell, index).min(axis=1) >= -1e-9
        owner[np.ravel_multi_index(tuple(index[inside].T), (n, n, n))] = cell[inside]

    sample = np.flatnonzero(phi <= 0)
    missing = owner < 0
    filled = int(missing[sample].sum())
    if missing.all():
        none = np.zeros(0, dtype=int)
        return PointLocation(none, none, np.zeros((0, 3)), np.zeros((0, 4)), filled)
    place = np.arange(n**3)
    if filled:
        nearest = distance_transform_edt(missing.reshape(n, n, n), return_distances=False, return_indices=True)
        place = np.ravel_multi_index(tuple(nearest), (n, n, n)).reshape(-1)
    place = place[sample]
    index, cell = np.stack(np.unravel_index(place, (n, n, n)), axis=1), owner[place]
    return PointLocation(sample, cell, index / scale - 1.0, weights(cell, index), filled)


def to_grid(mesh: TetMesh, value: np.ndarray, phi: np.ndarray) -> tuple[np.ndarray, int]:
    """The piecewise linear field ``value [N]`` at the grid points with Φ ≤ 0, zero at the others.

    Returns:
        float32 of the shape of ``phi``, and how many inner points took a neighbour's value, see :func:`locate_points`.
    """
    places = locate_points(mesh, phi)
    return places.to_grid(mesh, value, phi.shape[0]), places.filled

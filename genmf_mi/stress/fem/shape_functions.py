"""P1 shape functions on tetrahedra, for NumPy arrays and, where derivatives are wanted, for torch tensors."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np

if TYPE_CHECKING:
    from torch import Tensor

Array = TypeVar("Array", np.ndarray, "Tensor")


class ShapeFunctions(Generic[Array]):
    """The four linear shape functions of each cell; differentiable with respect to ``points`` if they are a tensor.

    volumes: ``[T]``, in cubic units of the points. gradients: ``[T,4,3]``, of the shape functions, one over the unit.

    Args:
        points: nodes ``[N,3]``. cells: ``[T,4]``, positively oriented; array or tensor as ``points``.
    """

    def __init__(self, points: Array, cells: Array) -> None:
        xp = namespace(points)
        self.points, self.cells, self.nodes = points, cells, len(points)
        corner = points[cells]
        edges = corner[:, 1:] - corner[:, :1]
        cofactors = xp.stack([xp.linalg.cross(edges[:, (i + 1) % 3], edges[:, (i + 2) % 3]) for i in range(3)], 1)
        six_volumes = xp.einsum("ti,ti->t", edges[:, 0], cofactors[:, 0])
        self.volumes: Array = six_volumes / 6
        # The gradients sum to zero, as the shape functions sum to one.
        others = cofactors / six_volumes[:, None, None]
        self.gradients: Array = xp.concatenate([-others.sum(1)[:, None], others], 1)

    def strain(self, displacement: Array) -> Array:
        """ε of ``displacement [N,3]`` in each cell, ``[T,3,3]``."""
        gradient = namespace(displacement).einsum("tai,taj->tij", displacement[self.cells], self.gradients)
        return (gradient + gradient.swapaxes(1, 2)) / 2

    def nodal_volume(self) -> Array:
        """∫ v, the volume that belongs to each node, ``[N]``."""
        return self._nodal(self.volumes / 4)

    def to_nodes(self, value: Array) -> Array:
        """Volume-weighted average of one value per cell ``[T]`` at the nodes, ``[N]``."""
        return self._nodal(self.volumes * value / 4) / self.nodal_volume()

    def barycentric(self, cell: Array, point: Array) -> Array:
        """Barycentric coordinates ``[M,4]`` of each ``point [M,3]`` in its ``cell [M]``."""
        xp = namespace(point)
        from_first = point - self.points[self.cells[cell, 0]]
        return xp.einsum("mai,mi->ma", self.gradients[cell], from_first) + xp.eye(4, dtype=point.dtype)[0]

    def _nodal(self, value: Array) -> Array:
        """Sum of one value per cell ``[T]`` over the cells at each node, ``[N]``."""
        to_corners = namespace(value).broadcast_to(value[:, None], self.cells.shape)
        return scatter_sum(self.cells.reshape(-1), to_corners.reshape(-1), self.nodes)


def triangle_areas(points: Array, faces: Array) -> Array:
    """Areas ``[F]`` of the triangles ``faces [F,3]``; arrays or tensors."""
    a, b, c = (points[faces[:, i]] for i in range(3))
    return (namespace(points).linalg.cross(b - a, c - a) ** 2).sum(1) ** 0.5 / 2


def scatter_sum(index: Array, value: Array, size: int) -> Array:
    """The sum of ``value [M]`` over each index 0..size-1 of ``index [M]``, ``[size]``; arrays or tensors."""
    if isinstance(value, np.ndarray):
        return np.bincount(index, value, size)
    return value.new_zeros(size).index_add(0, index, value)


def namespace(array: Any) -> Any:
    """NumPy for an array and torch for a tensor: the functions of one name that do the same in both."""
    if isinstance(array, np.ndarray):
        return np
    import torch

    return torch

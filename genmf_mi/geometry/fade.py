"""Masks with soft edges: the largest mask below a given one that rises no faster than it may."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra

_SMALLEST = 1e-12
"""In place of lengths of 0, which a sparse graph takes for missing edges."""


def faded(values: np.ndarray, vertices: np.ndarray, faces: np.ndarray, width: float) -> np.ndarray:
    """``[V]``: min over all vertices y of ``values[y]`` + d(x, y) / ``width``, with distances along the edges.

    It is the largest function that nowhere exceeds ``values`` and whose slope is at most 1 / ``width`` (the lower
    Lipschitz envelope). What is 0 stays 0 and beside it grows to 1 within ``width``. Along the edges, so that the other
    side of a thin wall is far away.

    Args:
        values: ``[V]``, not negative. vertices: ``[V,3]``. faces: ``[F,3]``. width: in the unit of the vertices.
    """
    count = len(values)
    edges = np.unique(np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    lengths = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    # One more node, from which each vertex is as far as its value allows: all sources in one search
    lengths = np.maximum(np.concatenate([lengths, values * width]), _SMALLEST)
    start = np.concatenate([edges[:, 0], np.full(count, count)])
    end = np.concatenate([edges[:, 1], np.arange(count)])
    graph = coo_matrix((lengths, (start, end)), shape=(count + 1, count + 1)).tocsr()
    # Undirected: a path that returns to the node would start over at 0, never shorter than from there
    distance = np.asarray(dijkstra(graph, directed=False, indices=count))[:count]
    return np.where(distance <= 2 * _SMALLEST, 0.0, np.minimum(distance / width, values))

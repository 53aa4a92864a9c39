"""Finer triangles where they are needed."""

from __future__ import annotations

import numpy as np


def halve_edges(vertices: np.ndarray, faces: np.ndarray, chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The chosen faces cut into four at the middles of their edges, and their neighbours so that all still fit.

    The surface stays as it is. A face with one neighbour that is cut into four is cut in two, one with several into
    four (Bank, Sherman and Weiser 1983, red–green refinement).

    Args:
        vertices: ``[V,3]``. faces: ``[F,3]``, closed. chosen: ``bool [F]``.

    Returns:
        vertices, the old ones first, and faces.
    """
    count = len(vertices)
    ends = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1), axis=-1)
    keys, edge = np.unique(ends[..., 0] * np.int64(count) + ends[..., 1], return_inverse=True)
    edge = edge.reshape(faces.shape)
    cut = np.zeros(len(keys), bool)
    while True:
        cut[edge[chosen]] = True
        more = (cut[edge].sum(axis=1) >= 2) & ~chosen
        if not more.any():
            break
        chosen = chosen | more
    middle = np.full(len(keys), -1)
    middle[cut] = count + np.arange(cut.sum())
    pairs = np.stack([keys // count, keys % count], axis=1)[cut]

    one = ~chosen & cut[edge].any(axis=1)
    first = cut[edge[one]].argmax(axis=1)[:, None]
    a, b, c = (np.take_along_axis(faces[one], (first + i) % 3, axis=1)[:, 0] for i in range(3))
    m = middle[np.take_along_axis(edge[one], first, axis=1)[:, 0]]
    (p, q, r), (pq, qr, rp) = faces[chosen].T, middle[edge[chosen]].T
    triangles = [(a, m, c), (m, b, c), (p, pq, rp), (pq, q, qr), (rp, qr, r), (pq, qr, rp)]
    new = np.concatenate([faces[~chosen & ~one], *(np.stack(t, axis=1) for t in triangles)])
    return np.concatenate([vertices, vertices[pairs].mean(axis=1)]), new

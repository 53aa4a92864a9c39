"""Self-intersections of a triangle mesh: MeshLab proposes faces, exact orientation signs decide."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from genmf_mi.mesh import meshlab, topology

_ERROR_BOUND = 1e-15
"""Relative rounding error of a 3×3 determinant of differences, a little above 7.8e-16 (Shewchuk 1997, orient3d)."""
TANGLED = 20
"""Faces that a face of garbage crosses, more than that."""
_FEWEST = 100
"""Faces below which a search is short whatever they are."""
_SAMPLES, _LOOKED_AT = 64, 200
"""Faces by which is judged, and faces near each of them."""


def self_intersections(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Indices ``int64 [K]`` of the faces of ``[F,3]`` that properly intersect another face, sorted."""
    candidates = meshlab.self_intersection_candidates(vertices, faces)
    return properly_intersecting(np.asarray(vertices, dtype=np.float64), np.asarray(faces), candidates)


def is_tangled(vertices: np.ndarray, faces: np.ndarray) -> bool:
    """Whether the faces ``[F,3]`` cross one another in so many places that they are no surface, but garbage.

    Judged by a few faces, spread over all of them: each crosses more than :data:`TANGLED` faces of its own component,
    or of open ones. Closed bodies may overlap as they like.
    """
    if len(faces) < _FEWEST:
        return False
    corners, piece = vertices[faces], topology.components(faces)
    low, high = corners.min(axis=1), corners.max(axis=1)
    is_open = np.isin(piece, piece[topology.boundary_faces(faces)])
    first: list[np.ndarray] = []
    second: list[np.ndarray] = []
    near = 0
    for face in _spread(len(faces), _SAMPLES):
        other = np.flatnonzero(((low <= high[face]) & (high >= low[face])).all(axis=1))
        other = other[(piece[other] == piece[face]) | is_open[other]]
        near += len(other)
        second.append(other[_spread(len(other), _LOOKED_AT)])
        first.append(np.full(len(second[-1]), face))
    if near <= TANGLED * len(first):
        return False
    crossing = _intersecting(vertices, faces, np.concatenate(first), np.concatenate(second)).mean()
    return bool(crossing * near > TANGLED * len(first))


def _spread(count: int, most: int) -> np.ndarray:
    """Indices below ``count``, at most ``most`` of them, evenly spread."""
    return np.unique(np.linspace(0, count - 1, min(most, count)).astype(np.int64))


def properly_intersecting(vertices: np.ndarray, faces: np.ndarray, candidates: np.ndarray) -> np.ndarray:
    """Those of the faces ``candidates [K]`` that properly intersect another candidate, sorted.

    An edge must pass through the interior of the other triangle: neighbours that share an edge, faces that merely touch
    and coplanar ones do not count.
    """
    pairs = _overlapping_boxes(vertices[faces[candidates]])
    first, second = candidates[pairs[:, 0]], candidates[pairs[:, 1]]
    intersects = _intersecting(vertices, faces, first, second)
    return np.unique(np.concatenate([first[intersects], second[intersects]]))


def _intersecting(vertices: np.ndarray, faces: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Whether the faces ``first [N]`` properly intersect the faces ``second [N]``, ``[N]``."""
    result = np.zeros(len(first), dtype=bool)
    shared = (faces[first][:, :, None] == faces[second][:, None, :]).any(axis=2).sum(axis=1)
    apart = np.flatnonzero(shared < 2)
    first, second = first[apart], second[apart]
    intersects = np.zeros(len(first), dtype=bool)
    for one, other in ((first, second), (second, first)):
        for corner in range(3):
            start, end = faces[one, corner], faces[one, (corner + 1) % 3]
            touching = ((faces[other] == start[:, None]) | (faces[other] == end[:, None])).any(axis=1)
            rows = np.flatnonzero(~intersects & ~touching)
            corners = vertices[faces[other[rows]]]
            intersects[rows] = _pierces(vertices[start[rows]], vertices[end[rows]], corners)
    result[apart] = intersects
    return result


def _pierces(start: np.ndarray, end: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Whether the segments ``start``–``end`` ``[N,3]`` pass through the interior of ``triangles [N,3,3]``."""
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    result = np.zeros(len(start), dtype=bool)
    rows = np.arange(len(start))
    side = _orientation(start, a, b, c)
    rows = rows[side != 0]
    rows = rows[_orientation(end[rows], a[rows], b[rows], c[rows]) == -side[rows]]
    turn = _orientation(start[rows], end[rows], a[rows], b[rows])
    rows, turn = rows[turn != 0], turn[turn != 0]
    for p, q in ((b, c), (c, a)):
        same = _orientation(start[rows], end[rows], p[rows], q[rows]) == turn
        rows, turn = rows[same], turn[same]
    result[rows] = True
    return result


def _orientation(p: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Exact sign ``[N]`` of the volume of the tetrahedra (p, a, b, c)."""
    u, v, w = a - p, b - p, c - p
    determinant = np.einsum("nk,nk->n", u, np.cross(v, w))
    magnitude = sum(
        np.abs(u[:, i]) * (np.abs(v[:, j] * w[:, k]) + np.abs(v[:, k] * w[:, j]))
        for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1))
    )
    sign = np.sign(determinant).astype(np.int64)
    for row in np.flatnonzero(np.abs(determinant) <= _ERROR_BOUND * magnitude):
        sign[row] = _exact_orientation(p[row], a[row], b[row], c[row])
    return sign


def _exact_orientation(*points: np.ndarray) -> int:
    p, a, b, c = ([Fraction(float(x)) for x in point] for point in points)
    u, v, w = ([x - y for x, y in zip(point, p)] for point in (a, b, c))
    determinant = (
        u[0] * (v[1] * w[2] - v[2] * w[1]) + u[1] * (v[2] * w[0] - v[0] * w[2]) + u[2] * (v[0] * w[1] - v[1] * w[0])
    )
    return (determinant > 0) - (determinant < 0)


def _overlapping_boxes(triangles: np.ndarray) -> np.ndarray:
    """Pairs ``[P,2]`` of triangles ``[K,3,3]`` whose bounding boxes overlap, by a sweep along the longest axis."""
    low, high = triangles.min(axis=1), triangles.max(axis=1)
    axis = int(np.ptp(low, axis=0).argmax()) if len(low) else 0
    order = np.argsort(low[:, axis])
    low, high = low[order], high[order]
    ends = np.searchsorted(low[:, axis], high[:, axis], side="right")
    pairs = []
    for index, end in enumerate(ends):
        others = np.arange(index + 1, end)
        hit = ((low[others] <= high[index]) & (high[others] >= low[index])).all(axis=1)
        pairs.append(np.stack([np.full(hit.sum(), index), others[hit]], axis=1))
    return order[np.concatenate(pairs)] if pairs else np.empty((0, 2), dtype=np.int64)

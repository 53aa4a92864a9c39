"""Polygons to triangles that stay inside them."""

from __future__ import annotations

import numpy as np


def triangles(points: np.ndarray, rings: list[list[int]]) -> tuple[np.ndarray, np.ndarray]:
    """Triangles of polygons with three and more corners.

    Convex polygons become fans; concave ones are cut in the plane that fits them best.

    Args:
        points: ``[V,3]``. rings: the corners of each polygon, as indices of points.

    Returns:
        Which polygon each triangle is of, ``[T]``, and which corners of it, counted from 0, ``[T,3]``.
    """
    sizes = np.array([len(ring) for ring in rings], dtype=np.int64)
    owners: list[np.ndarray] = []
    corners: list[np.ndarray] = []
    for size in np.unique(sizes):
        if size < 3:
            continue
        rows = np.flatnonzero(sizes == size)
        fans = np.stack([np.zeros(size - 2, int), np.arange(1, size - 1), np.arange(2, size)], axis=1)
        concave = _concave(points[np.array([rings[row] for row in rows])]) if size > 3 else np.zeros(len(rows), bool)
        convex = rows[~concave]
        owners.append(np.repeat(convex, size - 2))
        corners.append(np.tile(fans, (len(convex), 1)))
        for row in rows[concave]:
            cut = _cut(points[rings[row]])
            cut = fans if cut is None else cut
            owners.append(np.full(len(cut), row))
            corners.append(cut)
    if not owners:
        return np.empty(0, np.int64), np.empty((0, 3), np.int64)
    owner, corner = np.concatenate(owners), np.concatenate(corners)
    order = np.argsort(owner, kind="stable")
    return owner[order], corner[order].astype(np.int64)


def _normals(rings: np.ndarray) -> np.ndarray:
    """Newell's normals ``[P,3]`` of polygons ``[P,N,3]``, twice their areas long."""
    middle = rings - rings.mean(axis=1, keepdims=True)
    return np.cross(middle, np.roll(middle, -1, axis=1)).sum(axis=1)


def _concave(rings: np.ndarray) -> np.ndarray:
    """Whether polygons ``[P,N,3]`` turn the other way at a corner, ``[P]``."""
    after, before = np.roll(rings, -1, axis=1) - rings, rings - np.roll(rings, 1, axis=1)
    turns = np.einsum("pnk,pk->pn", np.cross(before, after), _normals(rings))
    return turns.min(axis=1) < -1e-9 * np.abs(turns).max(axis=1)


def _cut(ring: np.ndarray) -> np.ndarray | None:
    """Triangles ``[T,3]`` of one polygon ``[N,3]``; None if it has no area."""
    from manifold3d import triangulate

    normal = _normals(ring[None])[0]
    axis = int(np.abs(normal).argmax())
    if not np.isfinite(normal).all() or normal[axis] == 0:
        return None
    flat = np.delete(ring, axis, axis=1)
    # Seen along the axis, so that the polygon runs counter-clockwise
    mirrored = (normal[axis] < 0) != (axis == 1)
    flat = flat[:, ::-1] if mirrored else flat
    found = np.asarray(triangulate([np.ascontiguousarray(flat)]), dtype=np.int64).reshape(-1, 3)
    return found if len(found) == len(ring) - 2 else None

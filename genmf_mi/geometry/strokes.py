"""Where on a surface the strokes of a round brush lie, as signed distances to their outlines.

A stroke is the union of capsules about its segments. Where strokes overlap, the last one counts: as with solids in
constructive geometry, the region of a kind grows by the minimum of the distances, and loses what other strokes cover by
the maximum with their negative. The result is exact outside of a single stroke, nowhere larger than the distance to the
region, and continuous along its outline, so that fades are smooth however the surface is meshed.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import KDTree

from genmf_mi.core.regions import Stroke, StrokeKind

AGREEMENT = 0.35
"""Cosine between opposed normals from which on a place is as far from a stroke as the brush and the fade reach."""

Label = tuple[StrokeKind, float]
"""What strokes ask for: their kind, and their factor, 1 for kinds without."""


def label(stroke: Stroke) -> Label:
    """What a stroke asks for."""
    return stroke.kind, float(stroke.factor) if stroke.kind in ("stronger", "matters") else 1.0


def painted(
    points: np.ndarray, normals: np.ndarray, strokes: Sequence[Stroke], reach: float
) -> dict[Label, np.ndarray]:
    """For each label that was painted, how far each point is outside of its region; negative inside.

    Args:
        points: ``[V,3]`` mm. normals: ``[V,3]``, of unit length.
        strokes: with points in the same frame, in mm.
        reach: distances of ``reach`` and more are not looked for and given as infinite.

    Returns:
        ``[V]`` mm by label, without ``erase``.
    """
    tree, distances = KDTree(points), {label(s): np.full(len(points), np.inf) for s in strokes if s.kind != "erase"}
    for stroke in strokes:
        rows, distance = stroke_distance(points, normals, stroke, reach, tree)
        for each, total in distances.items():
            if each == label(stroke):
                total[rows] = np.minimum(total[rows], distance)
            else:
                total[rows] = np.maximum(total[rows], -distance)
    return distances


def stroke_distance(
    points: np.ndarray, normals: np.ndarray, stroke: Stroke, reach: float, tree: KDTree | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Signed distance to the outline of one stroke, of the points that it reaches.

    It is the largest of two: of the distance to the polyline less the radius, and of a term that grows where the normal
    of the surface turns away from that of the stroke, so that painting one side of a thin wall leaves the other alone.

    Args:
        points, normals, reach: as for :func:`painted`. tree: of ``points``.

    Returns:
        Indices ``[N]`` of the points less than ``reach`` away, and their distances ``[N]`` in mm.
    """
    tree = tree or KDTree(points)
    radius, far = stroke.radius_mm, stroke.radius_mm + reach
    facing = stroke.normals / np.linalg.norm(stroke.normals, axis=1, keepdims=True)
    count = len(stroke.points)
    ends = [(0, 0)] if count == 1 else list(zip(range(count - 1), range(1, count), strict=True))
    distance = np.full(len(points), np.inf)
    for a, b in ends:
        start, along = stroke.points[a], stroke.points[b] - stroke.points[a]
        near = tree.query_ball_point(start + along / 2, far + np.linalg.norm(along) / 2)
        if not near:
            continue
        rows = np.asarray(near)
        offset = points[rows] - start
        share = np.clip(offset @ along / max(float(along @ along), 1e-300), 0, 1)
        across = np.linalg.norm(offset - share[:, None] * along, axis=1) - radius
        normal = (1 - share)[:, None] * facing[a] + share[:, None] * facing[b]
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
        opposed = -np.einsum("nk,nk->n", normal, normals[rows])
        distance[rows] = np.minimum(distance[rows], np.maximum(across, opposed / AGREEMENT * far))
    rows = np.flatnonzero(distance < reach)
    return rows, distance[rows]

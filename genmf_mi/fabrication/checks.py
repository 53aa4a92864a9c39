"""The checks that a part must pass before anybody spends filament on it."""

from __future__ import annotations

from typing import Any

import numpy as np

from genmf_mi.mesh import topology
from genmf_mi.mesh.manifold import is_solid
from genmf_mi.mesh.measures import face_areas, signed_volume
from genmf_mi.mesh.nearest import distance_to_surface
from genmf_mi.mesh.self_intersections import self_intersections
from genmf_mi.render import bridge

THIN_PERCENTILE = 1.0
"""Percentile of the wall thickness that is reported as the smallest: a few sharp edges always measure zero."""


def check(vertices_mm: np.ndarray, faces: np.ndarray) -> dict[str, Any]:
    """What a slicer would complain about.

    Args:
        vertices_mm: ``[V,3]``. faces: ``[F,3]``.

    Returns:
        ``watertight`` (closed, oriented outwards, and a manifold to manifold3d), ``bodies``, ``self_intersections``
        (faces that cut through another), ``volume_mm3``, ``area_mm2``, ``size_mm`` (three extents) and
        ``min_thickness_mm``, see :func:`min_thickness`.
    """
    return {
        "watertight": bool(is_solid(vertices_mm, faces)),
        "bodies": int(topology.components(faces).max() + 1),
        "self_intersections": len(self_intersections(vertices_mm, faces)),
        "volume_mm3": float(signed_volume(vertices_mm, faces)),
        "area_mm2": float(face_areas(vertices_mm, faces).sum()),
        "size_mm": [float(x) for x in np.ptp(vertices_mm, axis=0)],
        "min_thickness_mm": min_thickness(vertices_mm, faces),
    }


def pieces(vertices_mm: np.ndarray, faces: np.ndarray) -> list[dict[str, Any]]:
    """What does not hang together with the largest component, the largest piece first.

    Args:
        vertices_mm: ``[V,3]`` on the print bed, z up. faces: ``[F,3]``.

    Returns:
        For each ``size_mm`` (three extents), ``centre_mm`` (from the middle of the part: to the right, to the back,
        upwards from the bed), ``above_bed_mm`` (its lowest point) and ``gap_mm`` to the largest component.
    """
    label = topology.components(faces)
    if label.max() == 0:
        return []
    sizes = [abs(float(signed_volume(vertices_mm, faces[label == number]))) for number in range(label.max() + 1)]
    main, *others = np.argsort(sizes)[::-1]
    low, high = vertices_mm[faces].min(axis=(0, 1)), vertices_mm[faces].max(axis=(0, 1))
    middle = np.array([*((low + high) / 2)[:2], low[2]])
    body = topology.compact(vertices_mm, faces[label == main])
    found: list[dict[str, Any]] = []
    for number in others:
        own = vertices_mm[np.unique(faces[label == number])]
        bottom, top = own.min(axis=0), own.max(axis=0)
        found.append(
            {
                "size_mm": [float(x) for x in top - bottom],
                "centre_mm": [float(x) for x in (bottom + top) / 2 - middle],
                "above_bed_mm": float(bottom[2] - low[2]),
                "gap_mm": float(distance_to_surface(own, *body).min()),
            }
        )
    return found


def min_thickness(vertices_mm: np.ndarray, faces: np.ndarray, samples: int = 20_000) -> float:
    """1st percentile of the wall thickness in mm over up to ``samples`` evenly spread faces, 0 without an inside: the
    length of a ray from the middle of a face, against its normal, until it leaves the solid."""
    chosen = np.linspace(0, len(faces) - 1, min(samples, len(faces))).astype(int)
    walls = bridge.wall_thickness(vertices_mm, faces, chosen)
    walls = walls[np.isfinite(walls)]
    return float(np.percentile(walls, THIN_PERCENTILE)) if len(walls) else 0.0

"""Voids that a pinhole joins to the outside: a thin shell around nothing, as generators leave it, is meant solid."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import ndimage

from genmf_mi.mesh import measures, repair, topology
from genmf_mi.mesh.manifold import is_solid
from genmf_mi.mesh.nearest import distance_to_surface
from genmf_mi.mesh.winding import winding_number

THIN = 0.05
"""Mean thickness over the longest side above which there is no room for a void."""
CELLS, PROBE_CELLS = 72, 1.5
"""Cells along the longest side; and radius, in cells, of the ball that must pass from outside: two hundredths of the
longest side."""
SMALLEST_VOID = 0.002
"""Share of the bounding box below which a void is left."""
_LOOKS = 5
"""Cells in front of a face in which is looked for what it faces."""


def filled(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """A closed surface without the walls of voids that no ball of :data:`PROBE_CELLS` comes into from outside, and the
    number of these. Cups and pipes stay as they are.

    Args:
        vertices: ``[V,3]``. faces: ``[F,3]``, closed and outwards.
    """
    longest = np.ptp(vertices, axis=0).max()
    thickness = 2 * measures.signed_volume(vertices, faces) / measures.face_areas(vertices, faces).sum()
    if thickness > THIN * longest:
        return vertices, faces, 0
    cell = longest / CELLS
    origin = vertices.min(axis=0) - 3 * cell
    shape = np.ceil(np.ptp(vertices, axis=0) / cell).astype(int) + 7
    points = origin + cell * np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1).reshape(-1, 3)
    outside = winding_number(points, vertices, faces) < 0.5
    outside[outside] = distance_to_surface(points[outside], vertices, faces) > PROBE_CELLS * cell
    untyped: Any = ndimage
    labelled: tuple[np.ndarray, int] = untyped.label(outside.reshape(shape))
    room, count = labelled
    sizes = np.bincount(room.ravel(), minlength=count + 1)
    exterior = room[0, 0, 0]
    voids = [k for k in range(1, count + 1) if k != exterior and sizes[k] > SMALLEST_VOID * room.size]
    if not voids:
        return vertices, faces, 0
    faced = _faced(vertices, faces, room, origin, cell)
    kept = faces[~np.isin(faced, voids)]
    if len(kept) == 0:
        return vertices, faces, 0
    kept, _ = repair.cap_holes(vertices, kept)
    new_vertices, new_faces = topology.compact(vertices, kept)
    if not is_solid(new_vertices, new_faces):
        return vertices, faces, 0
    return new_vertices, new_faces, len(voids)


def _faced(vertices: np.ndarray, faces: np.ndarray, room: np.ndarray, origin: np.ndarray, cell: float) -> np.ndarray:
    """The room ``[F]`` that lies in front of each face, 0 where there is none within :data:`_LOOKS` cells."""
    centres, normals = vertices[faces].mean(axis=1), measures.face_normals(vertices, faces)
    faced = np.zeros(len(faces), dtype=room.dtype)
    for step in range(_LOOKS, 0, -1):  # the nearest counts
        at = np.round((centres + step * cell * normals - origin) / cell).astype(int)
        at = np.clip(at, 0, np.array(room.shape) - 1)
        here = room[tuple(at.T)]
        faced = np.where(here > 0, here, faced)
    return faced

"""Areas, normals and volumes of triangle meshes, computed by libigl.

Vertices are ``[V,3]`` in any unit, faces ``[F,3]``, counter-clockwise seen from outside.
"""

from __future__ import annotations

import igl
import numpy as np


def face_areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Area ``float64 [F]`` of every face, in the square of the vertices' unit."""
    return np.asarray(igl.doublearea(vertices, faces)) / 2


def vertex_areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """A third of the area of the faces around each vertex, ``float64 [V]``."""
    return np.bincount(faces.ravel(), np.repeat(face_areas(vertices, faces) / 3, 3), len(vertices))


def face_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Unit normal ``float64 [F,3]`` of every face; zero where a face has no area."""
    return np.asarray(igl.per_face_normals(vertices, faces, np.zeros(3)))


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Unit normal ``float64 [V,3]`` at every vertex: the mean of the adjacent face normals, weighted by area.

    It is zero where there is none: at a vertex without faces, or whose faces have no area. The vertices must be finite.
    """
    weighting = igl.PerVertexNormalsWeightingType.PER_VERTEX_NORMALS_WEIGHTING_TYPE_AREA
    normals = np.asarray(igl.per_vertex_normals(vertices, faces, weighting))
    return np.where(np.isnan(normals), 0.0, normals)  # libigl divides by the length, which is zero there


def signed_volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Volume enclosed by closed faces, positive when they are oriented outwards.

    For an open surface it is the volume of the cones from the faces to the mean of the vertices.
    """
    # Relative to the mean, so that the digits do not cancel far from the origin
    _, volume = igl.centroid(vertices - vertices.mean(axis=0), faces)
    return float(volume)

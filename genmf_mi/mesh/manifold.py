"""Closed manifolds as ``manifold3d`` defines them."""

from __future__ import annotations

import manifold3d
import numpy as np

from genmf_mi.mesh import measures, topology


def to_manifold(vertices: np.ndarray, faces: np.ndarray) -> manifold3d.Manifold:
    """The faces as a ``manifold3d.Manifold``, whose ``status()`` says whether they are a closed manifold."""
    return manifold3d.Manifold(
        manifold3d.Mesh64(np.ascontiguousarray(vertices, np.float64), np.ascontiguousarray(faces, np.uint64))
    )


def to_arrays(solid: manifold3d.Manifold) -> tuple[np.ndarray, np.ndarray]:
    """Vertices ``float64 [V,3]`` and faces ``int64 [F,3]``."""
    mesh = solid.to_mesh64()
    return np.array(mesh.vert_properties[:, :3]), np.array(mesh.tri_verts, dtype=np.int64)


def is_solid(vertices: np.ndarray, faces: np.ndarray) -> bool:
    """Whether the faces are closed, consistently oriented, enclose a positive volume and pass ``manifold3d``."""
    if not topology.is_closed(faces) or measures.signed_volume(vertices, faces) <= 0:
        return False
    solid = to_manifold(vertices, faces)
    return not solid.is_empty() and solid.status() == manifold3d.Error.NoError

"""Closed manifolds as ``manifold3d`` has them, which is the judge of what is one."""

from __future__ import annotations

import numpy as np

from genmf_mi.mesh import topology


def to_manifold(vertices: np.ndarray, faces: np.ndarray):
    """The faces as a ``manifold3d.Manifold``, whose ``status()`` says whether they are one."""
    import manifold3d

    return manifold3d.Manifold(
        manifold3d.Mesh64(np.ascontiguousarray(vertices, np.float64), np.ascontiguousarray(faces, np.uint64))
    )


def to_arrays(body) -> tuple[np.ndarray, np.ndarray]:
    """Vertices ``[V,3]`` and faces ``[F,3]`` of a ``manifold3d.Manifold``."""
    mesh = body.to_mesh64()
    return np.array(mesh.vert_properties[:, :3]), np.array(mesh.tri_verts, dtype=np.int64)


def is_solid(vertices: np.ndarray, faces: np.ndarray) -> bool:
    """Whether the faces are closed, consistently oriented, enclose a positive volume and pass ``manifold3d``."""
    if not topology.is_closed(faces) or topology.volume(vertices, faces) <= 0:
        return False
    body = to_manifold(vertices, faces)
    return not body.is_empty() and body.status().name == "NoError"

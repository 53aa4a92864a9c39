"""The few things for which PyMeshLab is used; nothing else imports it.

PyMeshLab is under the GPL. It is loaded only when one of these functions runs.
"""

from __future__ import annotations

import numpy as np

from genmf_mi.mesh.self_intersections import crossing_faces

_SLIVER = 0.15
"""Twice the inradius over the circumradius: 1 for equilateral triangles; below this the smallest angle is about 5°."""


def self_intersections(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Indices of the faces of ``[F,3]`` that cut through another face, sorted ``int64``.

    MeshLab finds them fast but also reports thin triangles side by side in one plane; exact signs sort those out.
    """
    meshes = _load(vertices, faces)
    meshes.compute_selection_by_self_intersections_per_face()
    candidates = np.flatnonzero(meshes.current_mesh().face_selection_array())
    return crossing_faces(np.asarray(vertices, dtype=np.float64), np.asarray(faces), candidates)


def isotropic(
    vertices: np.ndarray, faces: np.ndarray, edge_length: float, *, iterations: int = 3, crease_degrees: float = 35.0
) -> tuple[np.ndarray, np.ndarray]:
    """Isotropic explicit remeshing (Botsch and Kobbelt 2004) towards ``edge_length``, reprojected onto the input.

    Edges that bend by more than ``crease_degrees`` stay where they are, except around the few slivers that this leaves.
    """
    from pymeshlab import PureValue

    # MeshLab's filters remember the last value of every parameter in the process: pass all that matter, every time.
    common = {
        "targetlen": PureValue(edge_length),
        "checksurfdist": True,
        "maxsurfdist": PureValue(edge_length / 2),
        "adaptive": False,
    }
    meshes = _load(vertices, faces)
    meshes.meshing_isotropic_explicit_remeshing(
        iterations=iterations, featuredeg=crease_degrees, selectedonly=False, **common
    )
    meshes.compute_scalar_by_aspect_ratio_per_face(metric="inradius/circumradius")
    meshes.compute_selection_by_condition_per_face(condselect=f"fq < {_SLIVER}")
    if meshes.current_mesh().face_selection_array().any():
        meshes.apply_selection_dilatation()
        meshes.meshing_isotropic_explicit_remeshing(iterations=2, featuredeg=180.0, selectedonly=True, **common)
    mesh = meshes.current_mesh()
    return mesh.vertex_matrix(), mesh.face_matrix().astype(np.int64)


def _load(vertices: np.ndarray, faces: np.ndarray):
    import pymeshlab

    meshes = pymeshlab.MeshSet(verbose=False)
    meshes.add_mesh(pymeshlab.Mesh(np.asarray(vertices, dtype=np.float64), np.asarray(faces, dtype=np.int32)))
    return meshes

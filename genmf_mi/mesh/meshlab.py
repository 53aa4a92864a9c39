"""The operations that PyMeshLab is used for; nothing else imports it.

PyMeshLab is under the GPL. It is loaded only when one of these functions runs.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

import numpy as np

from genmf_mi.core import llvm
from genmf_mi.core.errors import SetupError

_SLIVER = 0.15
"""Twice the inradius over the circumradius: 1 for equilateral triangles; below this the smallest angle is about 5°."""


def self_intersection_candidates(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Indices ``int64 [K]`` of the faces ``[F,3]`` that MeshLab takes for self-intersecting, sorted.

    Fast and complete, but it also reports thin triangles that lie side by side in one plane.
    """
    meshes = _load(vertices, faces)
    meshes.compute_selection_by_self_intersections_per_face()
    return np.flatnonzero(meshes.current_mesh().face_selection_array())


def isotropic_remeshing(
    vertices: np.ndarray, faces: np.ndarray, edge_length: float, *, iterations: int = 3, crease_degrees: float = 35.0
) -> tuple[np.ndarray, np.ndarray]:
    """Isotropic explicit remeshing (Botsch and Kobbelt 2004) towards ``edge_length``, reprojected onto the input.

    Edges with a dihedral angle of more than ``crease_degrees`` are preserved, except around the few slivers that this
    leaves.

    Returns:
        vertices ``float64 [V,3]`` and faces ``int64 [F,3]``.
    """
    pymeshlab = _pymeshlab()
    # MeshLab's filters remember the last value of every parameter in the process: pass all that matter, every time.
    common = {
        "targetlen": pymeshlab.PureValue(edge_length),
        "checksurfdist": True,
        "maxsurfdist": pymeshlab.PureValue(edge_length / 2),
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


def _load(vertices: np.ndarray, faces: np.ndarray) -> Any:
    pymeshlab = _pymeshlab()
    meshes = pymeshlab.MeshSet(verbose=False)
    meshes.add_mesh(pymeshlab.Mesh(np.asarray(vertices, dtype=np.float64), np.asarray(faces, dtype=np.int32)))
    return meshes


def _pymeshlab() -> Any:
    """The module, without a type: it has no stubs, and its names exist at run time only.

    Raises:
        SetupError: a shared library is missing. PyMeshLab itself then fails, or comes without some of its functions.
    """
    try:
        module: Any = import_module("pymeshlab")
    except ImportError as error:
        raise SetupError(f"PyMeshLab cannot be loaded: {error}. {llvm.advice()}") from error
    if not hasattr(module.MeshSet, "meshing_isotropic_explicit_remeshing"):
        raise SetupError(f"PyMeshLab cannot load its plugins. {llvm.advice()}")
    return module

"""A fine, near-uniform mesh of a solid: the one whose vertices are displaced."""

from __future__ import annotations

import numpy as np

from genmf_mi.core.errors import SolidError
from genmf_mi.mesh import measures, meshlab
from genmf_mi.mesh.manifold import is_solid, to_arrays, to_manifold
from genmf_mi.mesh.nearest import distance_to_surface
from genmf_mi.mesh.self_intersections import self_intersections

_WORST_DEVIATION = 2.0
"""In edge lengths: where a remeshed surface deviates more, subdivision is preferred if it fits the budget."""


def uniform(
    vertices: np.ndarray, faces: np.ndarray, edge_length: float, max_faces: int
) -> tuple[np.ndarray, np.ndarray, dict]:
    """Closed triangles of about ``edge_length`` on the surface of given closed ones, and a report.

    Isotropic remeshing gives even, well-shaped triangles and preserves creases. Should it break the solid, lose a
    detail or make the surface intersect itself, the triangles are merely subdivided, which leaves the surface exactly
    as it is. If that takes more than ``max_faces``, the remeshed surface is taken although it is not perfect; the
    report says so.

    Raises:
        SolidError: neither way gives a closed manifold within ``max_faces``.
    """
    wanted, shortest = edge_length, shortest_edge(vertices, faces, max_faces)
    imperfect = None
    for name, method in (("isotropic", _isotropic), ("divided", _divided)):
        edge_length = max(wanted, shortest)
        fine = method(vertices, faces, edge_length)
        for _ in range(3):
            if len(fine[1]) <= max_faces:
                break
            edge_length *= 1.02 * (len(fine[1]) / max_faces) ** 0.5
            fine = method(vertices, faces, edge_length)
        if len(fine[1]) > max_faces or not is_solid(*fine):
            continue
        report = {
            "method": name,
            "faces": len(fine[1]),
            "edge_length_wanted": float(wanted),
            "edge_length": float(edge_length),
            "max_deviation": _deviation(vertices, faces, *fine),
            **_self_intersections(vertices, faces, *fine, edge_length),
        }
        good = report["max_deviation"] <= _WORST_DEVIATION * edge_length and report["new_self_intersections"] == 0
        if good or name == "divided":
            return *fine, report
        imperfect = *fine, report
    if imperfect is None:
        raise SolidError(
            f"the solid cannot be meshed with {max_faces} triangles of length {wanted:.4g}. "
            "Allow more faces, or simplify the asset in a mesh editor."
        )
    return imperfect


def shortest_edge(vertices: np.ndarray, faces: np.ndarray, max_faces: int) -> float:
    """The edge length of equilateral triangles, ``max_faces`` of which cover the surface."""
    return float(np.sqrt(measures.face_areas(vertices, faces).sum() / max_faces * 4 / np.sqrt(3)))


def _isotropic(vertices: np.ndarray, faces: np.ndarray, edge_length: float) -> tuple[np.ndarray, np.ndarray]:
    # MeshLab splits an edge once per iteration: a coarse mesh has to be near the wanted length before.
    return meshlab.isotropic_remeshing(*_divided(vertices, faces, 4 / 3 * edge_length), edge_length)


def _divided(vertices: np.ndarray, faces: np.ndarray, edge_length: float) -> tuple[np.ndarray, np.ndarray]:
    return to_arrays(to_manifold(vertices, faces).refine_to_length(edge_length))


def _deviation(vertices: np.ndarray, faces: np.ndarray, fine_vertices: np.ndarray, fine_faces: np.ndarray) -> float:
    """The largest distance from the vertices of either surface to the other."""
    to_coarse = distance_to_surface(fine_vertices, vertices, faces).max()
    to_fine = distance_to_surface(vertices, fine_vertices, fine_faces).max()
    return float(max(to_coarse, to_fine))


def _self_intersections(
    vertices: np.ndarray, faces: np.ndarray, fine_vertices: np.ndarray, fine_faces: np.ndarray, edge_length: float
) -> dict[str, int]:
    """The number of self-intersections, and how many more they are than the input has in triangles of that size."""
    count = len(self_intersections(fine_vertices, fine_faces))
    before = len(self_intersections(vertices, faces)) if count else 0
    if before and count > before:  # finer triangles along one and the same intersection are more of them
        before = max(before, len(self_intersections(*_divided(vertices, faces, edge_length))))
    return {"self_intersections": count, "new_self_intersections": max(0, count - before)}

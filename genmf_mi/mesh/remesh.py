"""A fine, near-uniform mesh of a solid: what relief is carved into."""

from __future__ import annotations

import numpy as np

from genmf_mi.core.errors import SolidError
from genmf_mi.mesh import topology
from genmf_mi.mesh.manifold import is_solid, to_arrays, to_manifold

_WORST_DEVIATION = 2.0
"""In edge lengths: where a remeshed surface is farther off somewhere, division is preferred if it fits the budget."""


def fine(
    vertices: np.ndarray, faces: np.ndarray, edge_length: float, max_faces: int
) -> tuple[np.ndarray, np.ndarray, dict]:
    """Closed triangles of about ``edge_length`` on the surface of given closed ones, and a report.

    Isotropic remeshing gives even, well-shaped triangles and keeps creases. Should it break the solid, lose a detail or
    make the surface cut through itself, the triangles are merely divided, which leaves the surface exactly as it is. If
    that takes more than ``max_faces``, the remeshed surface is taken although it is not perfect; the report says so.

    Raises:
        SolidError: neither way gives a closed manifold within ``max_faces``.
    """

    wanted = edge_length
    shortest = float(np.sqrt(topology.areas(vertices, faces).sum() / max_faces * 4 / np.sqrt(3)))
    imperfect = None
    for name, method in (("isotropic", _isotropic), ("divided", _divided)):
        edge_length = max(wanted, shortest)
        for _ in range(4):
            made = method(vertices, faces, edge_length)
            if len(made[1]) <= max_faces:
                break
            edge_length *= 1.02 * (len(made[1]) / max_faces) ** 0.5
        if len(made[1]) > max_faces or not is_solid(*made):
            continue
        report = {
            "method": name,
            "faces": len(made[1]),
            "edge_length_wanted": float(wanted),
            "edge_length": float(edge_length),
            "max_deviation": _deviation(vertices, faces, *made),
            **_crossings(vertices, faces, *made, edge_length),
        }
        good = report["max_deviation"] <= _WORST_DEVIATION * edge_length and report["new_self_intersections"] == 0
        if good or name == "divided":
            return *made, report
        imperfect = *made, report
    if imperfect is None:
        raise SolidError(
            f"the solid cannot be meshed with {max_faces} triangles of length {wanted:.4g}. "
            "Allow more faces, or simplify the asset in a mesh editor."
        )
    return imperfect


def _isotropic(vertices: np.ndarray, faces: np.ndarray, edge_length: float) -> tuple[np.ndarray, np.ndarray]:
    from genmf_mi.mesh import meshlab

    # MeshLab splits an edge once per iteration: a coarse mesh has to be near the wanted length before.
    return meshlab.isotropic(*_divided(vertices, faces, 4 / 3 * edge_length), edge_length)


def _divided(vertices: np.ndarray, faces: np.ndarray, edge_length: float) -> tuple[np.ndarray, np.ndarray]:

    return to_arrays(to_manifold(vertices, faces).refine_to_length(edge_length))


def _deviation(vertices: np.ndarray, faces: np.ndarray, made_vertices: np.ndarray, made_faces: np.ndarray) -> float:
    """The largest distance from the vertices of either surface to the other."""
    there = topology.distance(made_vertices, vertices, faces).max()
    back = topology.distance(vertices, made_vertices, made_faces).max()
    return float(max(there, back))


def _crossings(
    vertices: np.ndarray, faces: np.ndarray, made_vertices: np.ndarray, made_faces: np.ndarray, edge_length: float
) -> dict[str, int]:
    """Faces that cut through another, and how many more they are than the same surface has in as small triangles."""
    from genmf_mi.mesh import meshlab

    count = len(meshlab.self_intersections(made_vertices, made_faces))
    before = len(meshlab.self_intersections(vertices, faces)) if count else 0
    if before and count > before:  # finer triangles along one and the same cut are more of them
        before = max(before, len(meshlab.self_intersections(*_divided(vertices, faces, edge_length))))
    return {"self_intersections": count, "new_self_intersections": max(0, count - before)}

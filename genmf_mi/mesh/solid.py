"""Closed manifold solids: from the triangles of an asset, and on to a fine mesh. ``manifold3d`` decides what is one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import manifold3d
import numpy as np

from genmf_mi.core.errors import SolidError
from genmf_mi.mesh import measures, rebuild, repair, topology, voids
from genmf_mi.mesh.manifold import is_solid, to_arrays, to_manifold
from genmf_mi.mesh.nearest import closest_points, distance_to_surface
from genmf_mi.mesh.refine import halve_edges
from genmf_mi.mesh.remesh import uniform
from genmf_mi.mesh.self_intersections import is_tangled, self_intersections
from genmf_mi.mesh.winding import winding_number

_WELD = 1e-6
"""Vertices closer than this share of the longest side are one."""

_STRAY = 0.01
"""A component below this share of the volume, or open components below this share of the area, are removed."""

_THINNEST = 5e-4
"""A closed mesh of less mean thickness, as a share of the longest side, is a sheet: 0.05 mm for a part of 100 mm."""

_LOST = 0.03
"""Share of the area that a rebuilt solid may leave outside before the asset counts as a sheet."""

HALVED_SHARE = 0.65
"""Of the face budget of :func:`refine`, for the first halving; the rest is for the second."""

_MOST_AT_AN_EDGE = 200
"""Triangles; two are right, and some dozens may be meant."""

_MOST_CAVITIES = 200
"""With more between overlapping components these are shreds, whose union is as jagged as they are: it is rebuilt."""

_INVENTED = 0.2
"""Share of the area of a rebuilt solid that may lie where the asset has no surface."""

Importance = Callable[[np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True, eq=False)
class Solid:
    """A closed, outward-facing manifold in file units.

    vertices: ``float64 [V,3]``; faces: ``int64 [F,3]``.
    report: what was done to obtain it, see :func:`solidify` and :func:`remesh`.
    """

    vertices: np.ndarray
    faces: np.ndarray
    report: dict[str, Any] = field(default_factory=dict[str, Any])


def solidify(name: str, vertices: np.ndarray, faces: np.ndarray) -> Solid:
    """Make one closed manifold of arbitrary triangles, changing as little as possible.

    Seams are welded, duplicate and collapsed faces removed, all faces oriented outwards, small holes capped and
    overlapping components united. Enclosed cavities are filled, and voids that only a pinhole opens. Only if that gives
    no manifold, the surface is rebuilt from a signed-distance field, 256 cells along the longest side.

    Args:
        name: of the asset, for messages.
        vertices: ``[V,3]`` in any unit.
        faces: ``[F,3]``.

    Returns:
        The solid. Its ``report`` has the counts of the input (``*_before``, and ``self_intersections_asset``, since a
        refinement's ``self_intersections_before`` are those of its fine mesh), of the result, and of every step.

    Raises:
        SolidError: the asset is a sheet without thickness, or cannot be closed.
    """
    before = len(vertices), len(faces)
    longest = np.ptp(vertices[faces].reshape(-1, 3), axis=0).max()
    vertices, faces = topology.weld(vertices, faces, _WELD * longest)
    faces = topology.without_duplicates(faces)
    if len(faces) == 0:
        raise SolidError(f"{name} encloses no volume: all its faces are collapsed. Export it again.")
    _require_surface(name, vertices, faces)
    faces, turned = topology.oriented(vertices, faces)
    vertices, faces = topology.compact(vertices, faces)
    boundary_edges, nonmanifold_edges = topology.boundary_and_nonmanifold_edges(faces)
    report = {
        "vertices_before": before[0],
        "faces_before": before[1],
        "bodies_before": int(topology.components(faces).max() + 1),
        "open_edges_before": boundary_edges,
        "crowded_edges_before": nonmanifold_edges,
        "self_intersections_asset": len(self_intersections(vertices, faces)),
        "volume_before": measures.signed_volume(vertices, faces),
        "faces_turned": turned,
        "holes_capped": 0,
        "inner_faces_dropped": 0,
        "stray_faces_dropped": 0,
        "stray_bodies_dropped": 0,
        "cavities_filled": 0,
        "voids_filled": 0,
        "touching_vertices_separated": 0,
        "rebuilt": False,
        "area_invented": 0.0,
    }
    if report["bodies_before"] > 1 or not is_solid(vertices, faces):
        vertices, faces, changes = _repaired(name, vertices, faces)
        report |= changes
    vertices, faces, report["voids_filled"] = voids.filled(vertices, faces)
    volume, area = measures.signed_volume(vertices, faces), measures.face_areas(vertices, faces).sum()
    if 2 * volume / area < _THINNEST * longest:
        raise SolidError(_sheet_message(name))
    report |= {
        "vertices": len(vertices),
        "faces": len(faces),
        "bodies": int(topology.components(faces).max() + 1),
        "volume": volume,
    }
    return Solid(vertices, faces, report)


def _require_surface(name: str, vertices: np.ndarray, faces: np.ndarray) -> None:
    """Raise :class:`SolidError` for garbage, in which searches that are short for surfaces would not end."""
    if (crowd := topology.most_crowded_edge(faces)) > _MOST_AT_AN_EDGE:
        raise SolidError(f"{name} is damaged: {crowd} triangles meet at one edge. Repair or export it again.")
    if is_tangled(vertices, faces):
        raise SolidError(
            f"{name} is damaged: nearly every triangle cuts through dozens of others. Repair or export it again."
        )


def remesh(solid: Solid, edge_length: float, max_faces: int = 200_000) -> Solid:
    """The same solid in near-uniform triangles.

    Args:
        edge_length: in file units; it grows if ``max_faces`` demands it.

    Returns:
        The fine solid. ``report["remesh"]`` has the method, the number of faces and the largest deviation from the
        surface in file units.

    Raises:
        SolidError: the solid cannot be meshed without breaking it.
    """
    vertices, faces, report = uniform(solid.vertices, solid.faces, edge_length, max_faces)
    return Solid(vertices, faces, solid.report | {"remesh": report})


def refine(meshed: Solid, original: Solid, importance: Importance, max_faces: int, finest: float = 0.0) -> Solid:
    """Triangles of a half and of a quarter of the size where they matter, as far as the budget allows.

    Args:
        meshed: what :func:`remesh` made of ``original``, on whose surface new vertices are put.
        importance: from vertices ``[V,3]`` and faces ``[F,3]`` to ``[F]``; where it is 0, faces stay as they are.
        max_faces: of the result. finest: no triangle of a shorter edge is made, in file units.

    Returns:
        The solid; ``report["remesh"]`` has the number of faces, and by how many they are more.
    """
    report = meshed.report["remesh"]
    halvings = 2 if finest == 0 else int(np.clip(np.floor(np.log2(report["edge_length"] / finest)), 0, 2))
    budgets = [round(share * max_faces) for share in (HALVED_SHARE, 1.0)[:halvings]]
    fine = _finer(meshed, importance, budgets, original)
    if len(self_intersections(*fine)) > report["self_intersections"] or not is_solid(*fine):
        fine = _finer(meshed, importance, budgets)  # new vertices on the flat triangles harm nothing
    vertices, faces = fine
    report = report | {"faces": len(faces), "finer_faces": len(faces) - len(meshed.faces)}
    return Solid(vertices, faces, meshed.report | {"remesh": report})


def _finer(
    meshed: Solid, importance: Importance, budgets: list[int], original: Solid | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Edges halved in the most important faces, once for each budget of faces."""
    vertices, faces = meshed.vertices, meshed.faces
    for budget in budgets:
        weight = importance(vertices, faces)
        affordable = max(0, (budget - len(faces)) // 4)  # a face becomes four, and some of its neighbours two
        threshold = np.partition(weight, -affordable)[-affordable] if 0 < affordable < len(faces) else 0.0
        chosen = (weight > 0) & (weight >= threshold) & (affordable > 0)
        fine, triangles = halve_edges(vertices, faces, chosen)
        if len(triangles) > budget:
            break
        if original is not None:
            _, fine[len(vertices) :], _ = closest_points(fine[len(vertices) :], original.vertices, original.faces)
        vertices, faces = fine, triangles
    return vertices, faces


def _repaired(name: str, vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, dict]:
    """The solid that the faces almost are, or failing that the rebuilt one; and what was changed."""
    changes: dict[str, int] = {}
    faces, changes["inner_faces_dropped"] = repair.without_inner_walls(vertices, faces)
    faces, changes["holes_capped"] = repair.cap_holes(vertices, faces)
    faces, _ = topology.oriented(vertices, faces)
    label = topology.components(faces)
    stray = np.isin(label, label[topology.boundary_faces(faces)])
    pieces = []
    for number in np.unique(label[~stray]):
        piece = to_manifold(*topology.compact(vertices, faces[label == number]))
        sound = piece.status() == manifold3d.Error.NoError
        # Solids that share an edge are one component to topology and several to manifold3d, which may overlap.
        solids = [part for part in piece.decompose() if part.volume() > 0] if sound else []
        if not solids:
            stray |= label == number
        pieces += solids
    area = measures.face_areas(vertices, faces)
    if pieces and area[stray].sum() <= _STRAY * area.sum():
        changes["stray_faces_dropped"] = int(stray.sum())
        new_vertices, new_faces, united = _united(pieces)
        if united.get("cavities_filled", 0) <= _MOST_CAVITIES and is_solid(new_vertices, new_faces):
            return new_vertices, new_faces, changes | united
    new_vertices, new_faces, united = _rebuilt(name, vertices, faces)
    return new_vertices, new_faces, changes | {"stray_faces_dropped": 0, "rebuilt": True} | united


def _united(pieces: list[manifold3d.Manifold]) -> tuple[np.ndarray, np.ndarray, dict]:
    """One mesh of overlapping solids, without small components and enclosed cavities."""
    whole = pieces[0] if len(pieces) == 1 else manifold3d.Manifold.batch_boolean(pieces, manifold3d.OpType.Add)
    parts = whole.decompose()
    volumes = np.array([part.volume() for part in parts])
    total = volumes[volumes > 0].sum()
    kept = [part for part, volume in zip(parts, volumes) if volume > _STRAY * total]
    if not kept:
        return np.empty((0, 3)), np.empty((0, 3), dtype=np.int64), {}
    meshes = [to_arrays(part) for part in kept]
    starts = np.cumsum([0] + [len(vertices) for vertices, _ in meshes])
    faces = np.concatenate([faces + start for (_, faces), start in zip(meshes, starts)])
    vertices, separated = repair.separate(np.concatenate([vertices for vertices, _ in meshes]), faces)
    return vertices, faces, {
        "stray_bodies_dropped": int(((volumes > 0) & (volumes <= _STRAY * total)).sum()),
        "cavities_filled": int((volumes <= 0).sum()),
        "touching_vertices_separated": separated,
    }  # fmt: skip


def _rebuilt(name: str, vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, dict]:
    """The surface rebuilt from a signed-distance field, and what was changed."""
    points, triangles, step = rebuild.rebuild(vertices, faces)
    if len(triangles) == 0:
        raise SolidError(_sheet_message(name))
    rebuilt = to_manifold(points, triangles).simplify(0.05 * step)
    if rebuilt.is_empty():
        raise SolidError(f"{name} cannot be closed. Repair it in a mesh editor (fill the holes) and try again.")
    new_vertices, new_faces, changes = _united([rebuilt])
    area, centres = measures.face_areas(vertices, faces), vertices[faces].mean(axis=1)
    lost = distance_to_surface(centres, new_vertices, new_faces) > 2 * step
    lost[lost] = winding_number(centres[lost], new_vertices, new_faces) < 0.5
    if area[lost].sum() > _LOST * area.sum():
        raise SolidError(_sheet_message(name))
    area, centres = measures.face_areas(new_vertices, new_faces), new_vertices[new_faces].mean(axis=1)
    invented = area[distance_to_surface(centres, vertices, faces) > 2 * step].sum() / area.sum()
    if invented > _INVENTED:
        raise SolidError(
            f"{name} is open: {invented:.0%} of its surface is missing. "
            "Close it in a mesh editor, or give it thickness (Blender: the Solidify modifier)."
        )
    return new_vertices, new_faces, changes | {"area_invented": float(invented)}


def _sheet_message(name: str) -> str:
    return (
        f"{name} is, or has parts that are, a sheet without thickness, which cannot be printed. "
        "Give it some in a mesh editor (Blender: the Solidify modifier) and try again."
    )

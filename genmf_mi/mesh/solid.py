"""Closed manifold solids: from an asset as it comes, and on to a fine mesh. ``manifold3d`` is the judge."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from genmf_mi.core.errors import SolidError
from genmf_mi.mesh import repair, topology
from genmf_mi.mesh.manifold import is_solid, to_arrays, to_manifold

_WELD = 1e-6
"""Vertices closer than this share of the longest side are one."""

_STRAY = 0.01
"""A separate body below this share of the volume, or open faces below this share of the area, are left out."""

_THINNEST = 5e-4
"""A closed mesh of less mean thickness, as a share of the longest side, is a sheet: 0.05 mm for a part of 100 mm."""

_LOST = 0.03
"""Share of the area that a rebuilt solid may leave outside before the asset counts as a sheet."""

_INVENTED = 0.2
"""Share of the area of a rebuilt solid that may lie where the asset has no surface."""


@dataclass(frozen=True, eq=False)
class Solid:
    """A closed, outward-facing manifold in file units.

    vertices: ``float64 [V,3]``; faces: ``int64 [F,3]``.
    report: what was done to get there, see :func:`solidify` and :func:`remesh`.
    """

    vertices: np.ndarray
    faces: np.ndarray
    report: dict = field(default_factory=dict)


def solidify(name: str, vertices: np.ndarray, faces: np.ndarray) -> Solid:
    """Make one closed manifold of a triangle soup, changing as little as possible.

    name: of the asset, for messages. vertices: ``[V,3]`` in any unit. faces: ``[F,3]``.

    Seams are welded, double and collapsed faces dropped, all faces turned outwards, small holes capped and overlapping
    bodies united. Cavities without a way out are filled. Only if that leaves no manifold, the surface is rebuilt from a
    signed-distance field, 256 cells along the longest side.

    ``report`` holds the counts of the input (``*_before``, and ``self_intersections_asset``, since a refinement's
    ``self_intersections_before`` are those of its fine mesh), of the result, and of every step.

    Raises:
        SolidError: the asset is a sheet without thickness, or cannot be closed.
    """
    from genmf_mi.mesh import meshlab

    before = len(vertices), len(faces)
    longest = np.ptp(vertices[faces].reshape(-1, 3), axis=0).max()
    vertices, faces = topology.weld(vertices, faces, _WELD * longest)
    faces = topology.without_duplicates(faces)
    if len(faces) == 0:
        raise SolidError(f"{name} encloses no volume: all its faces are collapsed. Export it again.")
    faces, turned = topology.oriented(vertices, faces)
    vertices, faces = topology.compact(vertices, faces)
    open_edges, crowded_edges = topology.edge_counts(faces)
    report = {
        "vertices_before": before[0],
        "faces_before": before[1],
        "bodies_before": int(topology.bodies(faces).max() + 1),
        "open_edges_before": open_edges,
        "crowded_edges_before": crowded_edges,
        "self_intersections_asset": len(meshlab.self_intersections(vertices, faces)),
        "volume_before": topology.volume(vertices, faces),
        "faces_turned": turned,
        "holes_capped": 0,
        "inner_faces_dropped": 0,
        "stray_faces_dropped": 0,
        "stray_bodies_dropped": 0,
        "cavities_filled": 0,
        "touching_vertices_separated": 0,
        "rebuilt": False,
        "area_invented": 0.0,
    }
    if report["bodies_before"] > 1 or not is_solid(vertices, faces):
        vertices, faces, changes = _mended(name, vertices, faces)
        report |= changes
    volume, area = topology.volume(vertices, faces), topology.areas(vertices, faces).sum()
    if 2 * volume / area < _THINNEST * longest:
        raise SolidError(_sheet(name))
    report |= {
        "vertices": len(vertices),
        "faces": len(faces),
        "bodies": int(topology.bodies(faces).max() + 1),
        "volume": volume,
    }
    return Solid(vertices, faces, report)


def remesh(solid: Solid, edge_length: float, max_faces: int = 200_000) -> Solid:
    """The same solid in near-uniform triangles.

    ``edge_length`` is in file units; it grows if ``max_faces`` demands it. ``report["remesh"]`` holds the method, the
    number of faces and the largest deviation from the surface in file units.

    Raises:
        SolidError: the solid cannot be meshed without breaking it.
    """
    from genmf_mi.mesh.remesh import fine

    vertices, faces, report = fine(solid.vertices, solid.faces, edge_length, max_faces)
    return Solid(vertices, faces, solid.report | {"remesh": report})


def _mended(name: str, vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, dict]:
    """The solid that the faces nearly are, or failing that the rebuilt one; and what was changed."""
    changes = {}
    faces, changes["inner_faces_dropped"] = repair.without_inner_walls(vertices, faces)
    faces, changes["holes_capped"] = repair.cap_holes(vertices, faces)
    faces, _ = topology.oriented(vertices, faces)
    label = topology.bodies(faces)
    stray = np.isin(label, label[topology.open_faces(faces)])
    pieces = []
    for number in np.unique(label[~stray]):
        piece = to_manifold(*topology.compact(vertices, faces[label == number]))
        # Bodies that share an edge are one body to ``bodies`` and several to manifold3d, which may overlap.
        solids = [part for part in piece.decompose() if part.volume() > 0] if piece.status().name == "NoError" else []
        if not solids:
            stray |= label == number
        pieces += solids
    area = topology.areas(vertices, faces)
    if pieces and area[stray].sum() <= _STRAY * area.sum():
        changes["stray_faces_dropped"] = int(stray.sum())
        new_vertices, new_faces, united = _united(pieces)
        if is_solid(new_vertices, new_faces):
            return new_vertices, new_faces, changes | united
    new_vertices, new_faces, united = _rebuilt(name, vertices, faces)
    return new_vertices, new_faces, changes | {"stray_faces_dropped": 0, "rebuilt": True} | united


def _united(pieces: list) -> tuple[np.ndarray, np.ndarray, dict]:
    """One mesh of overlapping ``manifold3d`` pieces, without small stray bodies and enclosed cavities."""
    import manifold3d

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
    import igl

    from genmf_mi.mesh.rebuild import rebuild

    points, triangles, step = rebuild(vertices, faces)
    if len(triangles) == 0:
        raise SolidError(_sheet(name))
    body = to_manifold(points, triangles).simplify(0.05 * step)
    if body.is_empty():
        raise SolidError(f"{name} cannot be closed. Repair it in a mesh editor (fill the holes) and try again.")
    new_vertices, new_faces, changes = _united([body])
    area, centres = topology.areas(vertices, faces), vertices[faces].mean(axis=1)
    lost = topology.distance(centres, new_vertices, new_faces) > 2 * step
    lost[lost] = igl.fast_winding_number(new_vertices, new_faces, centres[lost]) < 0.5
    if area[lost].sum() > _LOST * area.sum():
        raise SolidError(_sheet(name))
    area, centres = topology.areas(new_vertices, new_faces), new_vertices[new_faces].mean(axis=1)
    invented = area[topology.distance(centres, vertices, faces) > 2 * step].sum() / area.sum()
    if invented > _INVENTED:
        raise SolidError(
            f"{name} is open: {invented:.0%} of its surface is missing. "
            "Close it in a mesh editor, or give it thickness (Blender: the Solidify modifier)."
        )
    return new_vertices, new_faces, changes | {"area_invented": float(invented)}


def _sheet(name: str) -> str:
    return (
        f"{name} is, or has parts that are, a sheet without thickness, which cannot be printed. "
        "Give it some in a mesh editor (Blender: the Solidify modifier) and try again."
    )

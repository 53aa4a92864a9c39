"""The steps that turn a mesh as exported into components that ``manifold3d`` accepts. Each returns what it changed."""

from __future__ import annotations

import igl
import manifold3d
import numpy as np

from genmf_mi.mesh import measures, topology
from genmf_mi.mesh.winding import winding_number

_LARGEST_CAP = 0.2
"""A cap is at most this share of its component's area: the base of a bust is capped, the mouth of a bowl is not."""

_MOST_PATCHES = 64
"""With more patches than this, the signed-distance field decides what lies inside of what."""


def cap_holes(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, int]:
    """Faces with holes closed by flat triangles, and the number of holes closed.

    A large opening is closed only where it lies inside another component, like that of an eye set into a head.
    """
    label = topology.components(faces)
    component = np.empty(len(vertices), dtype=np.int64)
    component[faces] = label[:, None]
    limit = _LARGEST_CAP * np.bincount(label, measures.face_areas(vertices, faces))
    caps = []
    for loop in topology.boundary_loops(faces):
        ring = vertices[loop]
        offset = ring - ring.mean(axis=0)
        normal = np.cross(offset, np.roll(offset, -1, axis=0)).sum(axis=0) / 2
        area = np.linalg.norm(normal)
        if area == 0:
            continue
        own = component[loop[0]]
        if area > limit[own]:
            others = faces[label != own]
            if not 0 < label.max() < _MOST_PATCHES or (winding_number(ring, vertices, others) < 0.5).any():
                continue
        # Project along the mean normal: a frame whose third axis it is, in which the ring runs counter-clockwise.
        first = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
        first /= np.linalg.norm(first)
        second = np.cross(normal / area, first)
        triangles = manifold3d.triangulate([np.stack([offset @ first, offset @ second], axis=1)])
        if len(triangles) == len(loop) - 2:
            caps.append(loop[np.asarray(triangles)])
    return np.concatenate([faces, *caps]).astype(np.int64), len(caps)


def without_inner_walls(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, int]:
    """Faces without the open patches that lie inside what the others enclose, and the number of faces removed."""
    patch = np.asarray(igl.bfs_orient(np.ascontiguousarray(faces))[1])
    keep = np.ones(len(faces), dtype=bool)
    if 0 < patch.max() < _MOST_PATCHES:
        for number in range(patch.max() + 1):
            if topology.is_closed(faces[patch == number]):
                continue
            own, others = patch == number, keep & (patch != number)
            if not others.any():
                break
            centres = vertices[faces[own]].mean(axis=1)
            if (winding_number(centres, vertices, faces[others]) > 0.75).all():
                keep &= ~own
    return faces[keep], int((~keep).sum())


def separate(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, int]:
    """Vertices with those at the same position moved a little towards their own neighbours, and their number.

    Two corners that touch in a point or along an edge are fine for a mesh with indices, but a reader that welds by
    position, as every reader of STL does, would see an edge with four faces.
    """
    _, inverse, counts = np.unique(vertices, axis=0, return_inverse=True, return_counts=True)
    touching = counts[inverse.ravel()] > 1
    if not touching.any():
        return vertices, 0
    ends = topology.halfedges(faces)
    ends = ends[touching[ends[:, 0]]]
    total, number = np.zeros_like(vertices), np.bincount(ends[:, 0], minlength=len(vertices))
    np.add.at(total, ends[:, 0], vertices[ends[:, 1]])
    moved = vertices.copy()
    inwards = total[touching] / number[touching, None] - vertices[touching]
    length = np.maximum(np.linalg.norm(inwards, axis=1, keepdims=True), 1e-300)
    moved[touching] += np.minimum(0.01, 1e-4 * np.ptp(vertices, axis=0).max() / length) * inwards
    return moved, int(touching.sum())

"""What lies over the body of an asset: decals that float above it, and shells that are transparent in part.

The part is made of the body. Its colour at a point is that of the outermost opaque surface above it, so that a badge on
a separate quad is seen, and a sticker sheet only where something is printed on it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from genmf_mi.assets.albedo import Albedo
from genmf_mi.mesh import topology
from genmf_mi.mesh.measures import face_areas
from genmf_mi.mesh.nearest import Nearest, barycentric

HIGHEST, BESIDE = 0.03, 0.004
"""How far above the body an overlay may be, and how far beside a point its nearest, over the longest side."""
OPAQUE = 0.5
"""Opacity from which on a surface hides what is below, unless the file says otherwise."""
LARGEST_DECAL = 0.3
"""Share of the area up to which open pieces beside closed ones are decals."""
_WELD = 1e-6


@dataclass(frozen=True, eq=False)
class Overlay:
    """Some faces of an asset that lie over the others.

    faces: indices ``[K]`` among those of the asset. nearest: of these faces alone.
    cutoff: opacity from which on they are seen. decal: whether they are no part of the shape.
    """

    faces: np.ndarray
    nearest: Nearest
    cutoff: float
    decal: bool

    @classmethod
    def of(cls, rows: np.ndarray, vertices: np.ndarray, faces: np.ndarray, albedo: Albedo) -> Overlay:
        """Some ``rows [K]`` of :func:`split`."""
        cutoff = albedo.materials[albedo.material[rows[0]]].cutoff
        return cls(rows, Nearest(vertices, faces[rows]), OPAQUE if cutoff is None else cutoff, cutoff is None)

    def above(
        self, points: np.ndarray, normals: np.ndarray, longest: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Whether the overlay is above each of ``points [N,3]``, how high ``[N]``, and the face ``[N]`` and the point
        ``[N,3]`` of it; ``normals [N,3]`` of unit length."""
        face, closest, _ = self.nearest.find(points)
        offset = closest - points
        height = np.einsum("nk,nk->n", offset, normals)
        beside = np.linalg.norm(offset - height[:, None] * normals, axis=1)
        over = (height >= -BESIDE * longest) & (height <= HIGHEST * longest) & (beside <= BESIDE * longest)
        return over, height, self.faces[face], closest


def split(vertices: np.ndarray, faces: np.ndarray, albedo: Albedo) -> tuple[np.ndarray, list[np.ndarray]]:
    """Indices of the faces of the body ``[B]``, and of each overlay ``[K]``.

    Overlays are the faces of a material that lets something through, and small open pieces beside closed ones. If
    nothing would be left, all of it is the body.
    """
    groups: list[np.ndarray] = []
    taken = np.zeros(len(faces), dtype=bool)
    for number, material in enumerate(albedo.materials):
        rows = np.flatnonzero(albedo.material == number)
        if material.cutoff is None or len(rows) == 0:
            continue
        corners = np.concatenate([np.eye(3), np.full((1, 3), 1 / 3)])
        sampled = np.repeat(rows, len(corners)), np.tile(corners, (len(rows), 1))
        if (albedo.opacity(faces, *sampled) < material.cutoff).any():
            taken[rows] = True
            groups.append(rows)
    groups += _decals(vertices, faces, taken)
    for group in groups:
        taken[group] = True
    if taken.all():
        return np.arange(len(faces)), []
    return np.flatnonzero(~taken), groups


def _decals(vertices: np.ndarray, faces: np.ndarray, taken: np.ndarray) -> list[np.ndarray]:
    """Open components beside closed ones, each; none if they are too large to be decals."""
    longest = np.ptp(vertices[faces].reshape(-1, 3), axis=0).max()
    _, welded = topology.weld(vertices, faces, _WELD * longest)
    if len(welded) != len(faces):
        return []
    piece = topology.components(welded)
    count = int(piece.max()) + 1
    if count == 1:
        return []
    edges = np.sort(welded[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    _, first, uses = np.unique(edges, axis=0, return_index=True, return_counts=True)
    open_pieces = np.zeros(count, dtype=bool)
    open_pieces[np.unique(piece[first[uses == 1] // 3])] = True
    area = np.bincount(piece, face_areas(vertices, faces), count)
    if not open_pieces.any() or open_pieces.all() or area[open_pieces].sum() > LARGEST_DECAL * area.sum():
        return []
    return [rows for k in np.flatnonzero(open_pieces) if not taken[rows := np.flatnonzero(piece == k)].any()]


def outermost(
    overlays: list[Overlay],
    points: np.ndarray,
    normals: np.ndarray,
    below: tuple[np.ndarray, np.ndarray],
    vertices: np.ndarray,
    faces: np.ndarray,
    albedo: Albedo,
) -> tuple[np.ndarray, np.ndarray]:
    """Faces ``[N]`` and points ``[N,3]`` of ``below``, replaced by those of the highest opaque overlay above."""
    index, closest = below[0].copy(), below[1].copy()
    longest = float(np.ptp(vertices[faces].reshape(-1, 3), axis=0).max())
    highest = np.full(len(points), -np.inf)
    for overlay in overlays:
        over, height, face, point = overlay.above(points, normals, longest)
        rows = np.flatnonzero(over & (height > highest))
        at = barycentric(vertices[faces[face[rows]]], point[rows])
        rows = rows[albedo.opacity(faces, face[rows], at) >= overlay.cutoff]
        index[rows], closest[rows], highest[rows] = face[rows], point[rows], height[rows]
    return index, closest

"""Beads as triangles: every path swept with the cross-section that slicers reckon with.

A bead is as high as its layer and as wide as its line; its sides are half-ellipses (Slic3r, flow math: a rectangle with
round ends). Neighbouring beads overlap, which does no harm to a picture: the first surface that a ray meets is seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from genmf_mi.printing.paths import Bead

FAN = np.radians(25.0)
"""Corners that turn by more are rounded in steps of at most this."""


@dataclass(frozen=True)
class Triangles:
    """A mesh to look at: vertices ``[V,3]`` and their normals ``[V,3]``, faces ``[F,3]``."""

    vertices: np.ndarray
    normals: np.ndarray
    faces: np.ndarray

    @classmethod
    def joined(cls, parts: Sequence[Triangles]) -> Triangles:
        """All of them as one."""
        starts = np.cumsum([0] + [len(part.vertices) for part in parts])
        return cls(
            np.concatenate([part.vertices for part in parts]),
            np.concatenate([part.normals for part in parts]),
            np.concatenate([part.faces + start for part, start in zip(parts, starts)]),
        )


def sweep(beads: Sequence[Bead], bulge: float = 0.5, segments: int = 4) -> Triangles:
    """The surfaces of beads, all at once.

    Args:
        bulge: depth of a side in heights of the bead. segments: of either side.
    """
    beads = [bead for bead in map(_without_repetition, beads) if len(bead.points) > (2 if bead.closed else 1)]
    counts = np.array([len(bead.points) for bead in beads])
    if not len(counts):
        return Triangles(np.empty((0, 3)), np.empty((0, 3)), np.empty((0, 3), dtype=np.int64))
    points = np.concatenate([bead.points for bead in beads])
    half_width = np.concatenate([bead.width for bead in beads]) / 2
    first = np.repeat(np.cumsum(counts) - counts, counts)
    count = np.repeat(counts, counts)
    closed = np.repeat([bead.closed for bead in beads], counts)

    of, sideways, stretch, starts = _cross_sections(points, first, count, closed)
    height = np.repeat([bead.height for bead in beads], counts)[of]
    top = np.repeat([bead.top for bead in beads], counts)[of]
    side, inset, rise, outward, up = _profile(bulge, segments)

    reach = np.maximum(half_width[of, None] - inset * height[:, None], 0) * stretch[:, None] * side
    level = np.broadcast_to(points[of, None], (*reach.shape, 2)) + reach[..., None] * sideways[:, None]
    altitude = top[:, None] + (rise - 0.5) * height[:, None]
    vertices = np.concatenate([level, altitude[..., None]], axis=-1)
    normals = np.concatenate(
        [outward[:, None] * sideways[:, None], np.broadcast_to(up[:, None], (*reach.shape, 1))], axis=-1
    )
    around = len(side)
    here = np.arange(len(of))
    last = np.r_[starts[1:], True]  # of its path
    behind = np.where(last, np.maximum.accumulate(np.where(starts, here, 0)), here + 1)
    here, behind = (a[~(last & ~closed[of])] for a in (here, behind))
    a, b = np.arange(around), (np.arange(around) + 1) % around
    corners = [i[:, None] * around + k for i, k in ((here, a), (here, b), (behind, a), (behind, b))]
    faces = np.concatenate([np.stack([corners[0], corners[2], corners[3]], -1),
                            np.stack([corners[0], corners[3], corners[1]], -1)])  # fmt: skip
    return Triangles(vertices.reshape(-1, 3), normals.reshape(-1, 3), faces.reshape(-1, 3))


def _without_repetition(bead: Bead) -> Bead:
    """Without points that lie on the one before."""
    step = np.linalg.norm(np.diff(bead.points, axis=0), axis=1)
    keep = np.r_[True, step > 1e-4]
    if bead.closed and keep.sum() > 1 and np.linalg.norm(bead.points[keep][-1] - bead.points[0]) <= 1e-4:
        keep[np.flatnonzero(keep)[-1]] = False
    if keep.all():
        return bead
    return replace(bead, points=bead.points[keep], width=bead.width[keep])


def _cross_sections(
    points: np.ndarray, first: np.ndarray, count: np.ndarray, closed: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """One across the path at every point, several at sharp corners and at ends, which are rounded.

    Args:
        points: ``[N,2]``. first, count, closed: of the path of each point.

    Returns:
        The point of each cross-section ``[M]``, the direction to its right ``[M,2]``, by how much a corner widens it
        ``[M]``, and whether it is the first of its path ``[M]``.
    """
    place = np.arange(len(points)) - first
    after = np.where(place + 1 < count, np.arange(len(points)) + 1, first)
    before = np.where(place > 0, np.arange(len(points)) - 1, first + count - 1)
    ahead, behind = points[after] - points, points - points[before]
    start, end = ~closed & (place == 0), ~closed & (place + 1 == count)
    ahead[end], behind[start] = behind[end], ahead[start]
    right_behind, right_ahead = (np.arctan2(-d[:, 0], d[:, 1]) for d in (behind, ahead))
    turn = (right_ahead - right_behind + np.pi) % (2 * np.pi) - np.pi
    right_behind = np.where(start, right_ahead - np.pi, right_behind)
    turn = np.where(start | end, np.pi, turn)

    copies = np.where(np.abs(turn) < FAN, 1, np.ceil(np.abs(turn) / FAN).astype(int) + 1)
    of = np.repeat(np.arange(len(points)), copies)
    number = np.arange(len(of)) - np.repeat(np.cumsum(copies) - copies, copies)
    single = copies[of] == 1
    angle = right_behind[of] + turn[of] * np.where(single, 0.5, number / np.maximum(copies[of] - 1, 1))
    stretch = np.where(single, 1 / np.cos(np.where(single, turn[of], 0) / 2), 1.0)
    return of, np.stack([np.cos(angle), np.sin(angle)], axis=1), stretch, (place[of] == 0) & (number == 0)


def _profile(bulge: float, segments: int) -> tuple[np.ndarray, ...]:
    """Around a cross-section, up the right side and down the left, ``[K]`` each: the side (1 or -1), the distance from
    the widest place and the height above the middle, in heights of the bead; the normal's part along the side, signed,
    and up."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, segments + 1)
    angle = np.concatenate([angle, angle[::-1]])
    side = np.repeat([1.0, -1.0], segments + 1)
    outward, up = np.cos(angle) / max(bulge, 1e-6), np.sin(angle) / 0.5
    length = np.hypot(outward, up)
    return side, bulge * (1 - np.cos(angle)), np.sin(angle) / 2, side * outward / length, up / length

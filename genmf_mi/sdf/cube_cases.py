"""The 256 cases in which a surface can pass through a cube, derived from the signs at its corners.

Corner c of a cube lies at (x, y, z) = the bits 0, 1 and 2 of c. Edges are numbered as by Lorensen and Cline: the ring
0, 1, 5, 4 of the corners at y = 0, the same ring at y = 1, and the four links between the two. A case has bit c set if
corner c is inside.

On every face the edges that cross the surface are joined in pairs. A face whose diagonals differ in sign has two ways
of doing so; normally its inside corners are separated. A connected set of edges is a *patch*, and in dual marching
cubes (Nielson 2004) every patch has one vertex. If a patch runs through a face twice, and so does that of the adjacent
cube, then four faces would meet in the edge between their vertices. Wenger (*Isosurfaces*, 2013) and Shen et al.
(FlexiCubes, 2023; their cases C16 and C19) join the other pairs on that face, which splits both patches in two.
"""

from __future__ import annotations

from functools import cache

import numpy as np

RING = (0, 1, 5, 4)
LINKS = [(low, low + 2) for low in RING]
EDGES = [
    *((min(a, b) + up, max(a, b) + up) for up in (0, 2) for a, b in zip(RING, RING[1:] + RING[:1], strict=True)),
    *LINKS,
]
"""The corners at the two ends of each of the 12 edges, the lower one first."""


def faces() -> list[list[int]]:
    """The corners of each face, in order around it; face 2a + s lies at s on the axis a."""
    around = []
    for axis in range(3):
        u, v = 1 << (axis + 1) % 3, 1 << (axis + 2) % 3
        around += [[start, start + u, start + u + v, start + v] for start in (0, 1 << axis)]
    return around


def edge_between(a: int, b: int) -> int:
    """The edge between two corners."""
    return EDGES.index((min(a, b), max(a, b)))


def edge_at(axis: int, u: int, v: int) -> int:
    """The edge along ``axis`` at ``u`` on the next axis and ``v`` on the one after that (cyclic)."""
    low = (u << (axis + 1) % 3) + (v << (axis + 2) % 3)
    return edge_between(low, low + (1 << axis))


def patches(case: int, other_pairs_on: int = -1) -> tuple[np.ndarray, int]:
    """The patches of a case.

    Args:
        case: its number, 0 to 255.
        other_pairs_on: the face on which the outside corners are separated instead of the inside ones.

    Returns:
        The patch that each edge belongs to, ``[12]``, -1 where the surface does not cross it; and the face that some
        patch runs through twice, -1 if there is none.
    """
    inside = [bool(case >> corner & 1) for corner in range(8)]
    label = [edge if inside[a] != inside[b] else -1 for edge, (a, b) in enumerate(EDGES)]
    segments = [_segments(corners, inside, face == other_pairs_on) for face, corners in enumerate(faces())]
    for first, second in (pair for pairs in segments for pair in pairs):
        keep, drop = sorted((label[first], label[second]))
        label = [keep if number == drop else number for number in label]
    doubled = [
        face for face, pairs in enumerate(segments) if len(pairs) == 2 and len({label[e] for e, _ in pairs}) == 1
    ]
    numbers = sorted(set(label) - {-1})
    patch = [numbers.index(number) if number >= 0 else -1 for number in label]
    return np.array(patch), doubled[0] if doubled else -1


def _segments(corners: list[int], inside: list[bool], separate_outside: bool) -> list[tuple[int, int]]:
    """The pairs of edges that the surface joins on one face."""
    edges = [edge_between(corners[k - 1], corners[k]) for k in range(4)]  # before corner k
    crossed = [k for k in range(4) if inside[corners[k - 1]] != inside[corners[k]]]
    if len(crossed) < 4:
        return [(edges[crossed[0]], edges[crossed[1]])] if crossed else []
    separated = [k for k in range(4) if inside[corners[k]] != separate_outside]
    return [(edges[k], edges[(k + 1) % 4]) for k in separated]


@cache
def tables() -> tuple[np.ndarray, np.ndarray]:
    """All cases.

    Returns:
        ``int64 [512,12]``: the patch of every edge; row 256 + case is for the case with the other pairs on the face
        that a patch runs through twice. ``int64 [256]``: that face, or -1.
    """
    plain = [patches(case) for case in range(256)]
    other = [patches(case, face)[0] if face >= 0 else labels for case, (labels, face) in enumerate(plain)]
    return np.array([labels for labels, _ in plain] + other), np.array([face for _, face in plain])

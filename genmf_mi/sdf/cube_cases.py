"""The 256 ways in which a surface can pass through a cube, worked out from the signs at its corners.

Corner c of a cube lies at (x, y, z) = the bits 0, 1 and 2 of c. Edges are numbered as by Lorensen and Cline: the ring
0, 1, 5, 4 of the corners at y = 0, the same ring at y = 1, and the four links between the two. A case has bit c set if
corner c is inside.

On every face the edges that cross the surface are joined in pairs. A face whose diagonals differ in sign has two ways
of doing so; normally its inside corners are kept apart. What hangs together is a *patch*, and in dual marching cubes
(Nielson 2004) every patch has one vertex. If a patch runs through a face twice, and so does that of the cube next door,
then four faces would meet in the edge between their vertices. Wenger (*Isosurfaces*, 2013) and Shen et al. (FlexiCubes,
2023; their cases C16 and C19) join the other pairs on that face, which cuts both patches in two.
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
    """The corners of each face, in order around it; face 2a + s lies at s along the axis a."""
    around = []
    for axis in range(3):
        u, v = 1 << (axis + 1) % 3, 1 << (axis + 2) % 3
        around += [[start, start + u, start + u + v, start + v] for start in (0, 1 << axis)]
    return around


def edge_at(axis: int, u: int, v: int) -> int:
    """The edge along ``axis`` that lies at ``u`` along the next axis and at ``v`` along the one after (cyclic)."""
    low = (u << (axis + 1) % 3) + (v << (axis + 2) % 3)
    return EDGES.index((low, low + (1 << axis)))


def patches(case: int, other_pairs_on: int = -1) -> tuple[np.ndarray, int]:
    """The patches of a case.

    Args:
        other_pairs_on: the face on which outside corners are kept apart instead of inside ones.

    Returns:
        The patch that each edge belongs to, ``[12]``, -1 where the surface does not cross it; and the face that some
        patch runs through twice, -1 if there is none.
    """
    inside = [bool(case >> corner & 1) for corner in range(8)]
    label = [edge if inside[a] != inside[b] else -1 for edge, (a, b) in enumerate(EDGES)]
    segments = [_segments(corners, inside, face == other_pairs_on) for face, corners in enumerate(faces())]
    for first, second in (pair for pairs in segments for pair in pairs):
        keep, drop = sorted((label[first], label[second]))
        label = [keep if here == drop else here for here in label]
    doubled = [
        face for face, pairs in enumerate(segments) if len(pairs) == 2 and len({label[e] for e, _ in pairs}) == 1
    ]
    names = sorted(set(label) - {-1})
    return np.array([names.index(here) if here >= 0 else -1 for here in label]), doubled[0] if doubled else -1


def _segments(corners: list[int], inside: list[bool], keep_outside_apart: bool) -> list[tuple[int, int]]:
    """The pairs of edges that the surface joins on one face."""
    edges = [EDGES.index(tuple(sorted((corners[k - 1], corners[k])))) for k in range(4)]  # before corner k
    crossed = [k for k in range(4) if inside[corners[k - 1]] != inside[corners[k]]]
    if len(crossed) < 4:
        return [tuple(edges[k] for k in crossed)] if crossed else []
    apart = [k for k in range(4) if inside[corners[k]] != keep_outside_apart]
    return [(edges[k], edges[(k + 1) % 4]) for k in apart]


@cache
def tables() -> tuple[np.ndarray, np.ndarray]:
    """All cases.

    Returns:
        ``int64 [512,12]``: the patch of every edge; row 256 + case holds the case with the other pairs on its face that
        a patch runs through twice. ``int64 [256]``: that face, or -1.
    """
    plain = [patches(case) for case in range(256)]
    other = [patches(case, face)[0] if face >= 0 else labels for case, (labels, face) in enumerate(plain)]
    return np.array([labels for labels, _ in plain] + other), np.array([face for _, face in plain])

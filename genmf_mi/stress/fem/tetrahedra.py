"""Tetrahedra inside Φ < 0 by isosurface stuffing (Labelle & Shewchuk 2007, the graded variant left out).

A body-centred cubic lattice covers the shape. Lattice vertices that lie too near the surface are moved onto it, what is
left of the tetrahedra that it still cuts is split by a few templates. Neighbouring tetrahedra decide alike how a shared
quadrilateral is split, so the mesh is conforming, and no dihedral angle is ever small.
"""

from __future__ import annotations

import numpy as np

from genmf_mi.core.errors import SolidError
from genmf_mi.sdf.distance import sample
from genmf_mi.stress.fem.tet_mesh import TetMesh, compact

WARP_LONG, WARP_SHORT = 0.24999, 0.41189
"""A cut nearer to an end than this fraction of a long or short lattice edge pulls that end onto the surface
(Labelle & Shewchuk, table 1)."""

QUALITY_FLOOR = 0.2
"""Mean-ratio quality that every tetrahedron of a stuffed mesh must reach (1 is regular, 0 flat)."""


def isosurface_stuffing(phi: np.ndarray, edge: float) -> TetMesh:
    """Fill Φ < 0 with tetrahedra.

    Args:
        phi: ``[n,n,n]`` on [-1, 1]³, negative inside, positive on the border of the grid.
        edge: side of the lattice cells in the normalised frame; tetrahedra have edges of ``edge`` and 0.87 ``edge``.

    Raises:
        SolidError: nothing is inside, Φ has values that are not numbers, or a tetrahedron misses the quality bound.
    """
    if not np.isfinite(phi).all():
        raise SolidError("the distance field has values that are not numbers; rebuild it from a clean mesh.")
    lattice, cells, corners = _lattice(phi, edge)
    value = sample(phi, lattice)
    cells = _touched(value, cells)
    is_long = _long_test(corners)
    lattice, value = _warp(lattice, value, cells, is_long)
    cells = _touched(value, cells)
    mesh = compact(*_split(lattice, value, cells, is_long)).oriented()
    worst = float(mesh.quality.min())
    if worst < QUALITY_FLOOR:
        raise SolidError(
            f"a tetrahedron of quality {worst:.3f} came out, below {QUALITY_FLOOR}; choose another --edge-mm."
        )
    return mesh


def _lattice(phi: np.ndarray, edge: float) -> tuple[np.ndarray, np.ndarray, int]:
    """Body-centred cubic lattice over the inside of ``phi``: points, tetrahedra, and the number of corner points.

    Corner points come first, cell centres after them; an edge is long if it joins two of a kind.
    """
    n = phi.shape[0]
    inside = np.argwhere(phi < 0)
    if len(inside) == 0:
        raise SolidError("nothing is inside the distance field; the solid is empty or inside out.")
    low = (inside.min(axis=0) - 1) * (2.0 / (n - 1)) - 1.0 - edge
    high = (inside.max(axis=0) + 1) * (2.0 / (n - 1)) - 1.0 + edge
    shape = np.ceil((high - low) / edge).astype(np.int64) + 1
    corner = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1).reshape(-1, 3)
    centre = np.stack(np.meshgrid(*map(np.arange, shape - 1), indexing="ij"), axis=-1).reshape(-1, 3)
    points = low + edge * np.concatenate([corner, centre + 0.5])

    # A centre whose eight cell corners are all well outside has no tetrahedron to give.
    depth = sample(phi, points[len(corner) :]).reshape(shape - 1)
    near = depth < 1.5 * edge
    cells = []
    for direction in range(3):
        step, right, up = np.roll(np.eye(3, dtype=np.int64), -direction, axis=0)
        pair = np.logical_and(*(np.take(near, range(i, near.shape[direction] - 1 + i), direction) for i in (0, 1)))
        first = np.argwhere(pair)
        centre_id = [len(corner) + np.ravel_multi_index(tuple((first + o).T), shape - 1) for o in (0 * step, step)]
        ring = [np.ravel_multi_index(tuple((first + step + o).T), shape) for o in (0 * step, right, right + up, up)]
        cells += [np.stack([*centre_id, ring[i], ring[(i + 1) % 4]], axis=1) for i in range(4)]
    return points, np.concatenate(cells), len(corner)


def _touched(value: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """The cells that have a corner inside."""
    cells = cells[(value[cells] < 0).any(axis=1)]
    if len(cells) == 0:
        raise SolidError("the body is thinner than the tetrahedra everywhere; choose a smaller --edge-mm.")
    return cells


def _long_test(corners: int):
    return lambda a, b: (a < corners) == (b < corners)


def _cut_edges(value: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Edges ``[E,2]``, each once and sorted, whose ends have opposite signs."""
    i, j = np.triu_indices(4, 1)
    ends = np.sort(np.stack([cells[:, i], cells[:, j]], axis=-1).reshape(-1, 2), axis=1)
    inside = value < 0
    outside = value > 0
    ends = ends[(inside[ends[:, 0]] & outside[ends[:, 1]]) | (outside[ends[:, 0]] & inside[ends[:, 1]])]
    key = np.unique(ends[:, 0] * len(value) + ends[:, 1])
    return np.stack(np.divmod(key, len(value)), axis=1)


def _cut_points(points: np.ndarray, value: np.ndarray, edges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where Φ, taken as linear, vanishes on each edge: the share from the first end ``[E]``, the point ``[E,3]``."""
    first, second = edges.T
    t = value[first] / (value[first] - value[second])
    return t, points[first] + t[:, None] * (points[second] - points[first])


def _warp(points: np.ndarray, value: np.ndarray, cells: np.ndarray, is_long) -> tuple[np.ndarray, np.ndarray]:
    """Move every vertex that a cut comes too near to onto the nearest such cut; its value becomes exactly zero."""
    edges = _cut_edges(value, cells)
    t, cut = _cut_points(points, value, edges)
    limit = np.where(is_long(*edges.T), WARP_LONG, WARP_SHORT)
    index = np.arange(len(edges))
    vertex = np.concatenate([edges[t < limit, 0], edges[1 - t < limit, 1]])
    target = np.concatenate([index[t < limit], index[1 - t < limit]])
    distance = np.linalg.norm(cut[target] - points[vertex], axis=1)
    order = np.lexsort((distance, vertex))
    vertex, first = np.unique(vertex[order], return_index=True)
    points, value = points.copy(), value.copy()
    points[vertex] = cut[target[order][first]]
    value[vertex] = 0.0
    return points, value


def _split(points: np.ndarray, value: np.ndarray, cells: np.ndarray, is_long) -> tuple[np.ndarray, np.ndarray]:
    """Cut the tetrahedra at the surface and keep the inner parts, by the templates of Labelle & Shewchuk (figure 3)."""
    edges = _cut_edges(value, cells)
    _, cut = _cut_points(points, value, edges)
    size = len(points)
    key = edges[:, 0] * size + edges[:, 1]

    def at(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return size + np.searchsorted(key, np.minimum(a, b) * size + np.maximum(a, b))

    def first_wins(a: np.ndarray, b: np.ndarray, outer: np.ndarray) -> np.ndarray:
        """Which of the inner ends ``a``, ``b`` the diagonal of the face (a, b, outer) ends at.

        Both tetrahedra at the face see the same three vertices and so agree. A long cut edge takes the diagonal; with
        two short ones the lower index does, which is one and the same order for all faces.
        """
        long_a, long_b = is_long(a, outer), is_long(b, outer)
        return np.where(long_a == long_b, a < b, long_a)

    sign = np.sign(value)[cells]
    order = np.argsort(sign, axis=1, kind="stable")
    cells = np.take_along_axis(cells, order, axis=1)
    sign = np.take_along_axis(sign, order, axis=1)
    inner, outer = (sign < 0).sum(axis=1), (sign > 0).sum(axis=1)
    whole = [cells[outer == 0]]

    chosen = (inner == 1) & (outer > 0)
    a, small = cells[chosen, 0], cells[chosen].copy()
    for j in (1, 2, 3):
        beyond = sign[chosen, j] > 0
        small[beyond, j] = at(a[beyond], small[beyond, j])
    whole.append(small)

    a, b, zero, p = cells[(inner == 2) & (outer == 1)].T
    cut_a, cut_b, win = at(a, p), at(b, p), first_wins(a, b, p)
    whole += _pyramid(a, b, cut_b, cut_a, zero, win)

    a, b, p, q = cells[(inner == 2) & (outer == 2)].T
    top, bottom = np.stack([a, at(a, p), at(a, q)], 1), np.stack([b, at(b, p), at(b, q)], 1)
    win_p, win_q = first_wins(a, b, p), first_wins(a, b, q)
    # The third quadrilateral lies on the surface and is free: split it so that the three diagonals do not form a cycle.
    whole += _prism(top, bottom, np.stack([win_p, ~win_p, ~win_q], axis=1))

    a, b, c, p = cells[(inner == 3) & (outer == 1)].T
    top, bottom = np.stack([a, b, c], 1), np.stack([at(a, p), at(b, p), at(c, p)], 1)
    whole += _prism(top, bottom, np.stack([first_wins(a, b, p), first_wins(b, c, p), first_wins(c, a, p)], axis=1))
    return np.concatenate([points, cut]), np.concatenate(whole)


def _pyramid(a, b, c, d, apex, diagonal_ac) -> list[np.ndarray]:
    """Split the pyramid over the quadrilateral a, b, c, d along a–c or b–d."""
    one, other = diagonal_ac, ~diagonal_ac
    return [
        np.stack([a, b, c, apex], 1)[one],
        np.stack([a, c, d, apex], 1)[one],
        np.stack([a, b, d, apex], 1)[other],
        np.stack([b, c, d, apex], 1)[other],
    ]


def _prism(top: np.ndarray, bottom: np.ndarray, forward: np.ndarray) -> list[np.ndarray]:
    """Split prisms ``top [M,3]`` to ``bottom [M,3]`` into three tetrahedra each.

    ``forward[:, i]`` says that the quadrilateral over side i → i+1 has the diagonal top_i – bottom_{i+1}, else
    bottom_i – top_{i+1}. The three must not all agree, that prism cannot be split.
    """
    # Rotate so that corner 0 is the one whose top end meets the diagonals on both of its sides: side 0→1 forward and
    # side 2→0 backward. Such a corner exists unless the three agree.
    meets = forward & ~np.roll(forward, 1, axis=1)
    turn = (meets.argmax(axis=1)[:, None] + np.arange(3)) % 3
    t, b = np.take_along_axis(top, turn, axis=1), np.take_along_axis(bottom, turn, axis=1)
    middle = np.take_along_axis(forward, turn, axis=1)[:, 1]
    first = np.stack([t[:, 0], b[:, 0], b[:, 1], b[:, 2]], axis=1)
    across = _pyramid(t[:, 1], t[:, 2], b[:, 2], b[:, 1], t[:, 0], middle)
    return [first, *across]

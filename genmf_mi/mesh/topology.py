"""Connectivity of triangle meshes: welding, edges, components, orientation, holes.

A *boundary edge* has one face, a *non-manifold edge* three or more.
"""

from __future__ import annotations

import igl
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from genmf_mi.mesh import measures

_CROWDED = 100
"""Neighbours within the tolerance of a weld, on average, above which those of one cell are taken for one first."""


def weld(vertices: np.ndarray, faces: np.ndarray, tolerance: float) -> tuple[np.ndarray, np.ndarray]:
    """Merge vertices within ``tolerance`` (in their unit) and remove the unused; faces ``[F,3]`` keep their order."""
    used, faces = np.unique(faces, return_inverse=True)
    unique, inverse = np.unique(vertices[used], axis=0, return_inverse=True)
    tree = KDTree(unique)
    if tree.count_neighbors(tree, tolerance) > _CROWDED * len(unique):  # pairs that no memory would hold
        _, first, cell = np.unique(np.floor(unique / tolerance), axis=0, return_index=True, return_inverse=True)
        unique, inverse = unique[first], cell.ravel()[inverse.ravel()]
        tree = KDTree(unique)
    pairs = tree.query_pairs(tolerance, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs), dtype=np.int8), (pairs[:, 0], pairs[:, 1])), shape=(len(unique),) * 2)
    count, label = connected_components(graph, directed=False)
    first = np.full(count, len(unique))
    np.minimum.at(first, label, np.arange(len(unique)))
    return unique[first], label[inverse.ravel()][faces].reshape(-1, 3)


def compact(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Remove the vertices that no face uses."""
    used, inverse = np.unique(faces, return_inverse=True)
    return vertices[used], inverse.reshape(-1, 3)


def halfedges(faces: np.ndarray) -> np.ndarray:
    """Directed edges ``[3F,2]``; rows 3f, 3f+1, 3f+2 belong to face f."""
    return faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)


def _edge_ids(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Undirected edge of every half-edge ``[3F]`` and the number of faces at every edge ``[E]``."""
    ends = np.sort(halfedges(faces), axis=1)
    keys = ends[:, 0] * (faces.max(initial=0) + 1) + ends[:, 1]
    _, ids, counts = np.unique(keys, return_inverse=True, return_counts=True)
    return ids.ravel(), counts


def boundary_and_nonmanifold_edges(faces: np.ndarray) -> tuple[int, int]:
    """The number of boundary edges and of non-manifold edges."""
    _, counts = _edge_ids(faces)
    return int((counts == 1).sum()), int((counts > 2).sum())


def most_crowded_edge(faces: np.ndarray) -> int:
    """The most faces that meet at one edge."""
    return int(_edge_ids(faces)[1].max(initial=0))


def is_closed(faces: np.ndarray) -> bool:
    """Whether every edge has exactly two faces that run along it in opposite directions."""
    ends = halfedges(faces)
    size = faces.max(initial=0) + 1
    forward, backward = np.sort(ends[:, 0] * size + ends[:, 1]), np.sort(ends[:, 1] * size + ends[:, 0])
    return len(faces) > 0 and bool((forward[1:] != forward[:-1]).all() and (forward == backward).all())


def components(faces: np.ndarray) -> np.ndarray:
    """Component number ``[F]`` of every face, from 0 in the order of the faces; faces belong together when they share
    an edge.

    (``igl.facet_components`` lists all pairs of faces at an edge, which in damaged files are millions.)
    """
    ids, counts = _edge_ids(faces)
    edges = ids.reshape(-1, 3) + len(faces)
    size = len(faces) + len(counts)
    rows = np.repeat(np.arange(len(faces)), 3)
    graph = coo_array((np.ones(len(rows), dtype=np.int8), (rows, edges.ravel())), shape=(size, size))
    _, label = connected_components(graph, directed=False)
    _, first, number = np.unique(label[: len(faces)], return_index=True, return_inverse=True)
    rank = np.empty(len(first), dtype=np.int64)
    rank[np.argsort(first)] = np.arange(len(first))
    return rank[number]


def without_duplicates(faces: np.ndarray) -> np.ndarray:
    """Faces ``[F,3]`` with three distinct corners, each once.

    Two faces back to back are both removed if that leaves fewer boundary and non-manifold edges than keeping one of
    them. The first is right for a fold inside a closed surface, the second for a surface that was exported
    double-sided.
    """
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    rows = np.arange(len(faces))[:, None]
    start = faces.argmin(axis=1)[:, None]
    turned = faces[rows, (start + np.arange(3)) % 3]
    _, keep = np.unique(turned, axis=0, return_index=True)
    faces = faces[np.sort(keep)]
    _, keep, inverse, counts = np.unique(
        np.sort(faces, axis=1), axis=0, return_index=True, return_inverse=True, return_counts=True
    )
    if (counts == 1).all():
        return faces
    single, one_each = faces[counts[inverse.ravel()] == 1], faces[np.sort(keep)]
    return min(single, one_each, key=lambda kept: (len(kept) == 0, sum(boundary_and_nonmanifold_edges(kept))))


def oriented(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, int]:
    """Faces oriented consistently within each patch, such that it encloses a positive volume; and how many were turned.

    For an open patch the volume is that of the cone to its own centroid, which decides well for shells with holes.
    """
    turned, patch = map(np.asarray, igl.bfs_orient(np.ascontiguousarray(faces)))
    area, normal = measures.face_areas(vertices, turned), measures.face_normals(vertices, turned)
    count = patch.max() + 1
    total = np.maximum(np.bincount(patch, area, count), 1e-300)
    middle = vertices[turned].mean(axis=1)
    centroid = np.stack([np.bincount(patch, area * middle[:, k], count) / total for k in range(3)], axis=1)
    height = np.einsum("nk,nk->n", normal, middle - centroid[patch])
    signed = np.bincount(patch, area * height, count)  # three times the volume
    # A flat patch has no inside: leave it as it is rather than turn it for a rounding error
    extent = np.linalg.norm(np.ptp(vertices, axis=0))
    inwards = (signed < -1e-9 * total * extent)[patch]
    turned[inwards] = turned[inwards][:, ::-1]
    return turned, int((_parity(faces) != _parity(turned)).sum())


def _parity(faces: np.ndarray) -> np.ndarray:
    """Whether the corners of each face are an even permutation of their sorted order."""
    a, b, c = faces.T
    return ((a < b).astype(int) + (b < c) + (a < c)) % 2 == 1


def boundary_faces(faces: np.ndarray) -> np.ndarray:
    """Mask ``[F]`` of the faces that have a boundary edge."""
    ids, counts = _edge_ids(faces)
    return (counts[ids] == 1).reshape(-1, 3).any(axis=1)


def boundary_loops(faces: np.ndarray) -> list[np.ndarray]:
    """The rims of the holes: chains of boundary edges as vertex indices, in the direction of a face that fills it.

    Where two holes touch in a vertex, the chain continues along the other fan of faces there: each hole has its own.
    """
    # The same faces with a separate vertex for every fan
    fans = np.asarray(igl.split_nonmanifold(np.ascontiguousarray(faces))[0])
    ids, counts = _edge_ids(faces)
    rim = counts[ids] == 1
    tails, heads = halfedges(faces)[rim].T[::-1].tolist()
    tail_fans, head_fans = halfedges(fans)[rim].T[::-1].tolist()
    leaving: dict[int, list[int]] = {}
    for edge, tail in enumerate(tails):
        leaving.setdefault(tail, []).append(edge)
    used, loops = set(), []
    for start in range(len(tails)):
        loop, edge = [], start
        while edge not in used:
            used.add(edge)
            loop.append(tails[edge])
            ways = [way for way in leaving.get(heads[edge], []) if way not in used or way == start]
            if not ways:
                break
            edge = min(ways, key=lambda way: tail_fans[way] == head_fans[edge])
        if len(loop) >= 3 and edge == start:
            loops.append(np.array(loop))
    return loops

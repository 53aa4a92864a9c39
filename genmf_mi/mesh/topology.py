"""How triangles hang together: welding, edges, bodies, holes; and the few measures of them that need no more."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components


def weld(vertices: np.ndarray, faces: np.ndarray, tolerance: float) -> tuple[np.ndarray, np.ndarray]:
    """Merge vertices within ``tolerance`` (file units) and leave out the unused; faces ``[F,3]`` keep their order."""
    from scipy.spatial import cKDTree

    used, faces = np.unique(faces, return_inverse=True)
    unique, inverse = np.unique(vertices[used], axis=0, return_inverse=True)
    pairs = cKDTree(unique).query_pairs(tolerance, output_type="ndarray")
    count, label = _components(len(unique), pairs)
    first = np.full(count, len(unique))
    np.minimum.at(first, label, np.arange(len(unique)))
    return unique[first], label[inverse.ravel()][faces].reshape(-1, 3)


def compact(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Leave out the vertices that no face uses."""
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


def edge_counts(faces: np.ndarray) -> tuple[int, int]:
    """The number of open edges (one face) and of crowded ones (three faces or more)."""
    _, counts = _edge_ids(faces)
    return int((counts == 1).sum()), int((counts > 2).sum())


def is_closed(faces: np.ndarray) -> bool:
    """Whether every edge has exactly two faces that run along it in opposite directions."""
    ends = halfedges(faces)
    size = faces.max(initial=0) + 1
    forward, backward = np.sort(ends[:, 0] * size + ends[:, 1]), np.sort(ends[:, 1] * size + ends[:, 0])
    return len(faces) > 0 and bool((forward[1:] != forward[:-1]).all() and (forward == backward).all())


def bodies(faces: np.ndarray) -> np.ndarray:
    """Component number ``[F]`` of every face; faces belong together when they share an edge."""
    ids, _ = _edge_ids(faces)
    order = np.argsort(ids, kind="stable")
    same = ids[order][1:] == ids[order][:-1]
    pairs = np.stack([order[:-1][same], order[1:][same]], axis=1) // 3
    return _components(len(faces), pairs)[1]


def volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Signed volume of closed faces, positive when they look outwards."""
    a, b, c = (vertices[faces[:, corner]] - vertices.mean(axis=0) for corner in range(3))
    return float(np.einsum("nk,nk->", a, np.cross(b, c)) / 6)


def without_duplicates(faces: np.ndarray) -> np.ndarray:
    """Faces ``[F,3]`` with three distinct corners, each once.

    Two faces back to back cancel if that leaves fewer bad edges than keeping one of them: the first is a fold inside a
    closed surface, the second a surface that was exported double-sided.
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
    return min(single, one_each, key=lambda kept: (len(kept) == 0, sum(edge_counts(kept))))


def oriented(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, int]:
    """Faces that run the same way round within each patch and enclose a positive volume; and how many were turned.

    For an open patch the volume is that of the cone to its own centroid, which decides well for shells with holes.
    """
    import igl

    turned, patch = igl.bfs_orient(np.ascontiguousarray(faces))
    corner = vertices[turned]
    area = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    size = np.linalg.norm(area, axis=1)
    count = patch.max() + 1
    weight = np.maximum(np.bincount(patch, size, count), 1e-300)
    middle = corner.mean(axis=1)
    centroid = np.stack([np.bincount(patch, size * middle[:, k], count) / weight for k in range(3)], axis=1)
    signed = np.bincount(patch, np.einsum("nk,nk->n", area, middle - centroid[patch]), count)
    # A flat patch has no inside: leave it as it is rather than turn it for a rounding error.
    extent = np.linalg.norm(np.ptp(vertices, axis=0))
    inwards = (signed < -1e-9 * weight * extent)[patch]
    turned[inwards] = turned[inwards][:, ::-1]
    return turned, int((_parity(faces) != _parity(turned)).sum())


def _parity(faces: np.ndarray) -> np.ndarray:
    """Whether the corners of each face are an even permutation of their sorted order."""
    a, b, c = faces.T
    return ((a < b).astype(int) + (b < c) + (a < c)) % 2 == 1


def open_faces(faces: np.ndarray) -> np.ndarray:
    """Mask ``[F]`` of the faces that have an open edge."""
    ids, counts = _edge_ids(faces)
    return (counts[ids] == 1).reshape(-1, 3).any(axis=1)


def boundary_loops(faces: np.ndarray) -> list[np.ndarray]:
    """The rims of the holes: chains of open edges as vertex indices, in the direction that a filling face runs.

    Where two holes touch in a vertex, the chain goes on along the other fan of faces there: each hole has its own.
    """
    import igl

    fans = igl.split_nonmanifold(np.ascontiguousarray(faces))[0]  # the same faces, with a vertex of their own per fan
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


def _components(size: int, pairs: np.ndarray) -> tuple[int, np.ndarray]:
    graph = coo_array((np.ones(len(pairs), dtype=np.int8), (pairs[:, 0], pairs[:, 1])), shape=(size, size))
    return connected_components(graph, directed=False)


def areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Area ``[F]`` of every face."""
    corner = vertices[faces]
    return np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1) / 2


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Unit normals ``[V,3]``: the mean of the faces around, weighted by area."""
    corner = vertices[faces]
    face = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    around = np.repeat(face, 3, axis=0)
    normals = np.stack([np.bincount(faces.ravel(), around[:, k], len(vertices)) for k in range(3)], axis=1)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)


def distance(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Distance ``[N]`` of ``points [N,3]`` to a surface."""
    import igl

    squared, _, _ = igl.point_mesh_squared_distance(*map(np.ascontiguousarray, (points, vertices, faces)))
    return np.sqrt(squared)

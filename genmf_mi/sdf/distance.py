"""Φ: the signed distance of a surface, sampled on the grid [-1, 1]³, negative inside.

The sign comes from the generalised winding number (Jacobson et al. 2013, evaluated as in Barill et al. 2018), so open
and self-touching surfaces give the field one would expect. Magnitudes are exact within :data:`BAND` grid cells of the
surface. Further out they are distances to the point closest to the nearest such sample, which exceed the true distance
by a fraction of a cell near the medial axis and by less elsewhere.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from genmf_mi.core.errors import SolidError

BAND = 2.0
"""Half-width, in grid cells, of the layer about the surface in which Φ is exact."""


def axis(n: int) -> np.ndarray:
    """Sample positions along one axis of the grid, ``[n]``, from -1 to 1."""
    return np.linspace(-1.0, 1.0, n)


@dataclass(frozen=True)
class Band:
    """The samples near a surface and what of it is closest to them.

    index: place in the flattened grid ``[M]``. distance: ``[M]``. face: ``[M]``. closest: point on it ``[M,3]``.
    """

    index: np.ndarray
    distance: np.ndarray
    face: np.ndarray
    closest: np.ndarray


def band(vertices: np.ndarray, faces: np.ndarray, n: int = 129) -> Band:
    """All samples within :data:`BAND` cells of the surface, and some more. Raises as :func:`signed_distance`."""
    import igl

    vertices = np.ascontiguousarray(vertices, dtype=np.float64)
    faces = np.ascontiguousarray(faces, dtype=np.int64)
    if len(faces) == 0:
        raise SolidError("the surface has no faces; give a mesh with triangles.")
    if not np.isfinite(vertices).all():
        raise SolidError("the surface has vertices that are not numbers; export the mesh again.")
    index = _near_surface(vertices, faces, n)
    squared, face, closest = igl.point_mesh_squared_distance(index * (2.0 / (n - 1)) - 1.0, vertices, faces)
    return Band(np.ravel_multi_index(tuple(index.T), (n, n, n)), np.sqrt(squared), face, closest)


def signed_distance(vertices: np.ndarray, faces: np.ndarray, n: int = 129, near: Band | None = None) -> np.ndarray:
    """Φ of a triangle mesh in the normalised frame.

    Args:
        vertices: ``[V,3]``, inside [-1, 1]³.
        faces: ``[F,3]``.
        n: samples per axis.
        near: :func:`band` of the mesh, where it is known already.

    Returns:
        float32 ``[n,n,n]``, indexed x, y, z.

    Raises:
        SolidError: no faces, non-finite vertices, or nothing that the surface encloses.
    """
    near = near or band(vertices, faces, n)
    vertices = np.ascontiguousarray(vertices, dtype=np.float64)
    faces = np.ascontiguousarray(faces, dtype=np.int64)
    phi = _propagate(near.index, near.closest, n)
    phi[near.index] = near.distance
    inside = _sign(phi.reshape(n, n, n), vertices, faces).reshape(-1)
    if not inside.any():
        raise SolidError(
            "the surface encloses nothing that a grid of "
            f"{n}³ can see: it is flat, inside out, or thinner than a grid cell everywhere."
        )
    return np.where(inside, -phi, phi).astype(np.float32).reshape(n, n, n)


def _near_surface(vertices: np.ndarray, faces: np.ndarray, n: int) -> np.ndarray:
    """Indices ``[M,3]`` of the samples within about BAND cells of the surface (a superset)."""
    from scipy.ndimage import distance_transform_edt

    cell = 2.0 / (n - 1)
    touched = np.zeros((n, n, n), dtype=bool)
    for points in _surface_samples(vertices, faces, spacing=cell):
        index = np.clip(np.rint((points + 1.0) / cell).astype(np.int64), 0, n - 1)
        touched[tuple(index.T)] = True
    # A touched sample lies within √3/2 of a surface point, and every surface point within 1/√3 of such a point.
    return np.argwhere(distance_transform_edt(~touched) <= BAND + 1.5)


def _surface_samples(vertices: np.ndarray, faces: np.ndarray, spacing: float):
    """Yield point sets on the surface, no point of which is further than ``spacing`` from the next.

    Triangles are grouped by the number of subdivisions they need, so that each group is one array operation.
    """
    corners = vertices[faces]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    pieces = np.ceil(longest / spacing).astype(np.int64).clip(1)
    pieces = 2 ** np.ceil(np.log2(pieces)).astype(np.int64)
    for count in np.unique(pieces):
        i, j = np.meshgrid(np.arange(count + 1), np.arange(count + 1), indexing="ij")
        keep = i + j <= count
        weights = np.stack([i[keep], j[keep], count - i[keep] - j[keep]], axis=1) / count
        chosen = corners[pieces == count]
        for block in np.array_split(chosen, max(1, len(chosen) * len(weights) // 4_000_000)):
            yield np.einsum("kc,fcd->fkd", weights, block).reshape(-1, 3)


def _propagate(flat: np.ndarray, closest: np.ndarray, n: int) -> np.ndarray:
    """Unsigned distance everywhere, to the closest point that the nearest of the samples ``flat`` has."""
    from scipy.ndimage import distance_transform_edt

    slot = np.full(n**3, -1, dtype=np.int32)
    slot[flat] = np.arange(len(flat), dtype=np.int32)
    nearest = distance_transform_edt((slot < 0).reshape(n, n, n), return_distances=False, return_indices=True)
    source = slot[np.ravel_multi_index(tuple(nearest), (n, n, n)).reshape(-1)]
    ticks = axis(n)
    grid = np.stack(np.meshgrid(ticks, ticks, ticks, indexing="ij"), axis=-1).reshape(-1, 3)
    return np.linalg.norm(grid - closest[source], axis=1)


def _sign(magnitude: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Which samples are inside, ``[n,n,n]``.

    About a closed surface the winding number changes at the surface only, and between neighbours one of which is a cell
    or more from the surface there is no surface. So one value is enough for each region of such samples, the samples
    beside a region follow it, and only the rest is asked one by one. About an open surface every sample is asked.
    """
    import igl
    from scipy.ndimage import label

    n = magnitude.shape[0]
    cell = 2.0 / (n - 1)

    def wind(index: np.ndarray) -> np.ndarray:
        return igl.fast_winding_number(vertices, faces, index * cell - 1.0) > 0.5

    if not _closed(vertices, faces):
        return wind(np.argwhere(np.ones_like(magnitude, dtype=bool))).reshape(magnitude.shape)
    regions, count = label(magnitude >= cell)
    labels, first = np.unique(regions, return_index=True)
    verdict = np.zeros(count + 1, dtype=bool)
    where = np.stack(np.unravel_index(first[labels > 0], magnitude.shape), axis=1)
    if count:
        verdict[labels[labels > 0]] = wind(where)
    inside, known = verdict[regions], regions > 0
    core = known.copy()
    for direction in range(3):
        for here, there in ((slice(1, None), slice(None, -1)), (slice(None, -1), slice(1, None))):
            to = (slice(None),) * direction + (here,)
            source = (slice(None),) * direction + (there,)
            take = core[source] & ~known[to]
            inside[to][take] = inside[source][take]
            known[to][take] = True
    rest = np.argwhere(~known)
    if len(rest):
        inside[tuple(rest.T)] = wind(rest)
    return inside


def _closed(vertices: np.ndarray, faces: np.ndarray) -> bool:
    """Whether every edge is passed as often one way as the other, vertices in one place taken as one."""
    _, index = np.unique(vertices, axis=0, return_inverse=True)
    faces = index.reshape(-1)[faces]
    start, stop = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)
    key = np.minimum(start, stop) * (index.max() + 1) + np.maximum(start, stop)
    _, edge = np.unique(key, return_inverse=True)
    return not np.bincount(edge.reshape(-1), np.sign(stop - start)).any()


def sample(phi: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Φ (or any field on the grid) at ``points [N,3]`` of the normalised frame, trilinear; clamped outside the grid."""
    from scipy.ndimage import map_coordinates

    n = phi.shape[0]
    return map_coordinates(phi, (np.asarray(points).T + 1.0) * ((n - 1) / 2), order=1, mode="nearest")


def lost_fraction(vertices: np.ndarray, faces: np.ndarray, phi: np.ndarray, samples: int = 4000) -> float:
    """Fraction of the surface under which the body is thinner than two grid cells and may be lost on this grid.

    Judged one cell below the surface, along the inward normal: there Φ should be about minus one cell.
    """
    cell = 2.0 / (phi.shape[0] - 1)
    corners = np.asarray(vertices)[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normals, axis=1)
    if not area.sum() > 0:
        return 1.0
    rng = np.random.default_rng(0)
    chosen = rng.choice(len(faces), size=samples, p=area / area.sum())
    weights = rng.dirichlet((1.0, 1.0, 1.0), size=samples)
    points = np.einsum("nc,ncd->nd", weights, corners[chosen])
    inward = -normals[chosen] / area[chosen, None]
    return float((sample(phi, points + cell * inward) > -0.5 * cell).mean())

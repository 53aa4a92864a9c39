"""Φ: the signed distance of a surface, sampled on the grid [-1, 1]³, negative inside.

The sign comes from the generalised winding number (Jacobson et al. 2013, evaluated as in Barill et al. 2018), so open
and self-touching surfaces give the expected field. Magnitudes are exact in the narrow band, :data:`NARROW_BAND_CELLS`
on either side of the surface. Farther away they are distances to the surface point of the nearest sample in the band,
which exceed the true distance by a fraction of a cell near the medial axis and by less elsewhere.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import cast

import numpy as np
from scipy import ndimage

from genmf_mi.core.errors import SolidError
from genmf_mi.mesh import measures
from genmf_mi.mesh.nearest import closest_points
from genmf_mi.mesh.winding import winding_number
from genmf_mi.sdf.grid import flat_index, regions

NARROW_BAND_CELLS = 2.0
"""Half-width, in grid cells, of the layer about the surface in which Φ is exact."""


def axis(n: int) -> np.ndarray:
    """Sample positions along one axis of the grid, ``[n]``, from -1 to 1."""
    return np.linspace(-1.0, 1.0, n)


@dataclass(frozen=True)
class NarrowBand:
    """The samples near a surface and the points of the surface closest to them.

    index: ``[M]``, index into the flattened grid.
    distance: ``[M]``, unsigned, normalised units.
    face: ``[M]``, index of the closest face.
    closest: ``[M,3]``, the closest point on it.
    """

    index: np.ndarray
    distance: np.ndarray
    face: np.ndarray
    closest: np.ndarray


def narrow_band(vertices: np.ndarray, faces: np.ndarray, n: int = 129) -> NarrowBand:
    """All samples within :data:`NARROW_BAND_CELLS` of the surface, and some more.

    Arguments and errors are those of :func:`signed_distance`.
    """
    vertices = np.ascontiguousarray(vertices, dtype=np.float64)
    faces = np.ascontiguousarray(faces, dtype=np.int64)
    if len(faces) == 0:
        raise SolidError("the surface has no faces; give a mesh with triangles.")
    if not np.isfinite(vertices).all():
        raise SolidError("the surface has vertices that are not numbers; export the mesh again.")
    index = _near_surface(vertices, faces, n)
    face, closest, distance = closest_points(index * (2.0 / (n - 1)) - 1.0, vertices, faces)
    return NarrowBand(flat_index(index, n), distance, face, closest)


def signed_distance(
    vertices: np.ndarray, faces: np.ndarray, n: int = 129, band: NarrowBand | None = None
) -> np.ndarray:
    """Φ of a triangle mesh in the normalised frame.

    Args:
        vertices: ``[V,3]``, inside [-1, 1]³.
        faces: ``[F,3]``.
        n: samples per axis.
        band: :func:`narrow_band` of the mesh, if it is known already.

    Returns:
        float32 ``[n,n,n]``, indexed x, y, z.

    Raises:
        SolidError: there are no faces, vertices are not finite, or the surface encloses no sample.
    """
    band = band or narrow_band(vertices, faces, n)
    vertices = np.ascontiguousarray(vertices, dtype=np.float64)
    faces = np.ascontiguousarray(faces, dtype=np.int64)
    phi = _propagate(band.index, band.closest, n)
    phi[band.index] = band.distance
    inside = _sign(phi.reshape(n, n, n), vertices, faces).reshape(-1)
    if not inside.any():
        raise SolidError(
            "the surface encloses nothing that a grid of "
            f"{n}³ can resolve: it is flat, inside out, or thinner than a grid cell everywhere."
        )
    return np.where(inside, -phi, phi).astype(np.float32).reshape(n, n, n)


def _near_surface(vertices: np.ndarray, faces: np.ndarray, n: int) -> np.ndarray:
    """Indices ``[M,3]`` of the samples within NARROW_BAND_CELLS of the surface, and some more."""
    cell = 2.0 / (n - 1)
    touched = np.zeros((n, n, n), dtype=bool)
    for points in _surface_samples(vertices, faces, spacing=cell):
        index = np.clip(np.rint((points + 1.0) / cell).astype(np.int64), 0, n - 1)
        touched[tuple(index.T)] = True
    # A touched sample lies within √3/2 of a surface point, and every surface point within 1/√3 of such a point.
    distance = cast(np.ndarray, ndimage.distance_transform_edt(~touched))
    return np.argwhere(distance <= NARROW_BAND_CELLS + 1.5)


def _surface_samples(vertices: np.ndarray, faces: np.ndarray, spacing: float) -> Iterator[np.ndarray]:
    """Yield sets of points ``[N,3]`` on the surface, neighbours in a face at most ``spacing`` apart.

    Triangles are grouped by the number of subdivisions they need, so that each group is one array operation.
    """
    corners = vertices[faces]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    subdivisions = np.ceil(longest / spacing).astype(np.int64).clip(1)
    subdivisions = 2 ** np.ceil(np.log2(subdivisions)).astype(np.int64)
    for count in np.unique(subdivisions):
        i, j = np.meshgrid(np.arange(count + 1), np.arange(count + 1), indexing="ij")
        keep = i + j <= count
        weights = np.stack([i[keep], j[keep], count - i[keep] - j[keep]], axis=1) / count
        chosen = corners[subdivisions == count]
        for block in np.array_split(chosen, max(1, len(chosen) * len(weights) // 4_000_000)):
            yield np.einsum("kc,fcd->fkd", weights, block).reshape(-1, 3)


def _propagate(flat: np.ndarray, closest: np.ndarray, n: int) -> np.ndarray:
    """Unsigned distance ``[n³]`` of every sample to the ``closest [M,3]`` point of the nearest one in ``flat [M]``."""
    slot = np.full(n**3, -1, dtype=np.int32)
    slot[flat] = np.arange(len(flat), dtype=np.int32)
    outside = (slot < 0).reshape(n, n, n)
    nearest = ndimage.distance_transform_edt(outside, return_distances=False, return_indices=True)
    source = slot[flat_index(cast(np.ndarray, nearest).reshape(3, -1).T, n)]
    ticks = axis(n)
    grid = np.stack(np.meshgrid(ticks, ticks, ticks, indexing="ij"), axis=-1).reshape(-1, 3)
    return np.linalg.norm(grid - closest[source], axis=1)


def _sign(magnitude: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Which samples are inside, bool ``[n,n,n]``.

    Around a closed surface the winding number changes at the surface only, and there is no surface between neighbours
    one of which is a cell or more away from it. So one value is enough for each region of such samples, the samples
    next to a region take its value, and only the rest is evaluated one by one. Around an open surface every sample is.
    """
    n = magnitude.shape[0]
    cell = 2.0 / (n - 1)

    def is_inside(index: np.ndarray) -> np.ndarray:
        return winding_number(index * cell - 1.0, vertices, faces) > 0.5

    if not _closed(vertices, faces):
        return is_inside(np.argwhere(np.ones_like(magnitude, dtype=bool))).reshape(magnitude.shape)
    region, count = regions(magnitude >= cell)
    numbers, first = np.unique(region, return_index=True)
    region_inside = np.zeros(count + 1, dtype=bool)
    if count:
        representatives = np.stack(np.unravel_index(first[numbers > 0], magnitude.shape), axis=1)
        region_inside[numbers[numbers > 0]] = is_inside(representatives)
    inside, known = region_inside[region], region > 0
    core = known.copy()
    for direction in range(3):
        for shifted, source in ((slice(1, None), slice(None, -1)), (slice(None, -1), slice(1, None))):
            to = (slice(None),) * direction + (shifted,)
            of = (slice(None),) * direction + (source,)
            take = core[of] & ~known[to]
            inside[to][take] = inside[of][take]
            known[to][take] = True
    rest = np.argwhere(~known)
    if len(rest):
        inside[tuple(rest.T)] = is_inside(rest)
    return inside


def _closed(vertices: np.ndarray, faces: np.ndarray) -> bool:
    """Whether every edge is used as often in one direction as in the other; vertices at one position count as one."""
    _, index = np.unique(vertices, axis=0, return_inverse=True)
    faces = index.reshape(-1)[faces]
    start, stop = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)
    key = np.minimum(start, stop) * (index.max() + 1) + np.maximum(start, stop)
    _, edge = np.unique(key, return_inverse=True)
    return not np.bincount(edge.reshape(-1), np.sign(stop - start)).any()


def sample(phi: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Φ (or any field on the grid) at ``points [N,3]`` of the normalised frame, trilinear; clamped outside the grid."""
    n = phi.shape[0]
    return ndimage.map_coordinates(phi, (np.asarray(points).T + 1.0) * ((n - 1) / 2), order=1, mode="nearest")


def thin_fraction(vertices: np.ndarray, faces: np.ndarray, phi: np.ndarray, samples: int = 4000) -> float:
    """Fraction of the surface where the solid is thinner than two grid cells and may be lost on this grid.

    Judged one cell below the surface, along the inward normal: Φ should be about minus one cell there.
    """
    cell = 2.0 / (phi.shape[0] - 1)
    vertices = np.asarray(vertices)
    area = measures.face_areas(vertices, faces)
    if not area.sum() > 0:
        return 1.0
    rng = np.random.default_rng(0)
    chosen = rng.choice(len(faces), size=samples, p=area / area.sum())
    weights = rng.dirichlet((1.0, 1.0, 1.0), size=samples)
    points = np.einsum("nc,ncd->nd", weights, vertices[faces[chosen]])
    inward = -measures.face_normals(vertices, faces)[chosen]
    return float((sample(phi, points + cell * inward) > -0.5 * cell).mean())

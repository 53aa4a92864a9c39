"""The samples and cubes of a grid that a surface can reach while it is displaced by no more than a cap."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from genmf_mi.mesh.nearest import Nearest, barycentric
from genmf_mi.sdf.grid import flat_index

_CUBE = 0.87
"""Half the diagonal of a cube, in cells."""


@dataclass(frozen=True)
class Shell:
    """A layer about a surface, and the points of the surface closest to it.

    samples: ``[N]`` and cubes: ``[K]``, ascending indices into the flattened grids of m³ and n³.
    edges: ``[E,2]``, rows of samples that are neighbours along an axis.
    places: ``[N,3]`` and centres: ``[K,3]``, the positions of the samples and of the centres of the cubes.
    distance: ``[N]``, to the surface.
    face, weights: ``[N]``, ``[N,3]``, the closest point of each sample in barycentric coordinates.
    cube_face, cube_weights: ``[K]``, ``[K,3]``, likewise of each centre.
    """

    samples: np.ndarray
    cubes: np.ndarray
    edges: np.ndarray
    places: np.ndarray
    centres: np.ndarray
    distance: np.ndarray
    face: np.ndarray
    weights: np.ndarray
    cube_face: np.ndarray
    cube_weights: np.ndarray


def shell(
    inside: np.ndarray, deformation: np.ndarray | None, vertices: np.ndarray, faces: np.ndarray, cap: float
) -> Shell:
    """All samples and cubes within ``cap`` plus a cell of the surface, except for the border of the grid.

    Args:
        inside: bool ``[m,m,m]``, the signs that the surface was extracted with.
        deformation: ``[m,m,m,3]``, displacement of the samples, or None.
        vertices: ``[V,3]`` of the surface, in the units of the grid [-1, 1]³.
        faces: ``[F,3]``.
        cap: the largest displacement, in the same units.
    """
    m = len(inside)
    n, cell = m - 1, 2 / (m - 1)
    near = np.zeros_like(inside)
    for axis in range(3):
        crossed = np.diff(inside, axis=axis)
        for start in (0, 1):  # both ends
            near[tuple(slice(start, n + start) if k == axis else slice(None) for k in range(3))] |= crossed
    near = ndimage.binary_dilation(near, iterations=int(np.ceil(cap / cell)) + 2)
    near[[0, -1]] = near[:, [0, -1]] = near[:, :, [0, -1]] = False

    tree = Nearest(vertices, faces)
    index = np.argwhere(near)
    places = index * cell - 1.0
    if deformation is not None:
        places = places + deformation[tuple(index.T)]
    face, closest, distance = tree.find(places)
    keep = distance <= cap + cell
    index, places, distance = index[keep], places[keep], distance[keep]
    face, closest = face[keep], closest[keep]
    samples = flat_index(index, m)

    row = np.full(m**3, -1)
    row[samples] = np.arange(len(samples))
    edges = [np.stack([row[samples], row[samples + step]], axis=1) for step in (m * m, m, 1)]
    edges = np.concatenate(edges)

    corner = np.unique(np.concatenate([index - offset for offset in np.ndindex(2, 2, 2)]), axis=0)
    centres = (corner + 0.5) * cell - 1.0
    cube_face, cube_closest, away = tree.find(centres)
    keep = away <= cap + _CUBE * cell
    corner, centres = corner[keep], centres[keep]
    cube_face, cube_closest = cube_face[keep], cube_closest[keep]
    return Shell(
        samples=samples,
        cubes=flat_index(corner, n),
        edges=edges[edges[:, 1] >= 0],
        places=places,
        centres=centres,
        distance=distance,
        face=face,
        weights=barycentric(vertices[faces[face]], closest),
        cube_face=cube_face,
        cube_weights=barycentric(vertices[faces[cube_face]], cube_closest),
    )

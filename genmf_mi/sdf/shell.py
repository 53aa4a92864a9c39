"""The samples and cubes of a grid that a surface can come to while it moves by no more than a cap."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from genmf_mi.mesh.nearest import Nearest, barycentric

_CUBE = 0.87
"""Half the diagonal of a cube, in cells."""


@dataclass(frozen=True)
class Shell:
    """A layer about a surface, and what of the surface is closest to it.

    samples: ``[N]`` and cubes: ``[K]``, ascending indices into the flattened grids of m³ and n³. edges: ``[E,2]``, rows
    of samples that are neighbours along an axis. places: ``[N,3]`` and centres: ``[K,3]``, where they are.
    distance: ``[N]``, to the surface. face, weights: ``[N]``, ``[N,3]``, the closest point of each sample in
    barycentric coordinates; cube_face, cube_weights: likewise of each centre.
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
    """All within ``cap`` and a cell of the surface, except for the border of the grid.

    inside: ``[m,m,m]``, the signs that the surface was extracted with. deformation: ``[m,m,m,3]`` or None.
    vertices ``[V,3]``, faces ``[F,3]``: the surface; as ``cap``, in the units of the grid [-1, 1]³.
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
    index, places, face, closest, distance = (x[keep] for x in (index, places, face, closest, distance))
    samples = np.ravel_multi_index(tuple(index.T), inside.shape)

    row = np.full(m**3, -1)
    row[samples] = np.arange(len(samples))
    edges = [np.stack([row[samples], row[samples + step]], axis=1) for step in (m * m, m, 1)]
    edges = np.concatenate(edges)

    corner = np.unique(np.concatenate([index - offset for offset in np.ndindex(2, 2, 2)]), axis=0)
    centres = (corner + 0.5) * cell - 1.0
    cube_face, cube_closest, away = tree.find(centres)
    keep = away <= cap + _CUBE * cell
    corner, centres, cube_face, cube_closest = (x[keep] for x in (corner, centres, cube_face, cube_closest))
    return Shell(
        samples=samples,
        cubes=np.ravel_multi_index(tuple(corner.T), (n, n, n)),
        edges=edges[edges[:, 1] >= 0],
        places=places,
        centres=centres,
        distance=distance,
        face=face,
        weights=barycentric(vertices[faces[face]], closest),
        cube_face=cube_face,
        cube_weights=barycentric(vertices[faces[cube_face]], cube_closest),
    )

"""Operations on a field on a grid: sign, border, cavities, small components, axes, scale.

They turn a generator's grid into an :class:`genmf_mi.assets.sdf_asset.SdfAsset`.
"""

from __future__ import annotations

from typing import cast

import numpy as np
from scipy import ndimage

from genmf_mi.core.errors import AssetError
from genmf_mi.sdf.cube_cases import EDGES, edge_between

AMBIGUOUS_SHARE = 0.1
"""Share of the border that may be inside: the object is cut off there. With more, the outside cannot be determined."""

SMALL_COMPONENT_SHARE = 0.01
"""A separate component with a smaller share of the samples inside is removed."""


def flat_index(index: np.ndarray, size: int) -> np.ndarray:
    """Indices ``[M]`` into the flattened grid ``[size,size,size]`` of the samples or cubes ``index [M,3]``."""
    return np.asarray(np.ravel_multi_index(tuple(index.T), (size, size, size)))


def regions(mask: np.ndarray) -> tuple[np.ndarray, int]:
    """The connected regions of a mask, by neighbours along the axes: numbers from 1, 0 outside; and how many."""
    return cast(tuple[np.ndarray, int], ndimage.label(mask))


def border(shape: tuple[int, ...]) -> np.ndarray:
    """Mask of the outermost samples of a grid."""
    mask = np.ones(shape, dtype=bool)
    mask[1:-1, 1:-1, 1:-1] = False
    return mask


def outside_positive(field: np.ndarray, where: str) -> np.ndarray:
    """``field [m,m,m]`` or its negative, whichever is positive on the border, since no object extends beyond the grid.

    Raises:
        AssetError: values that are not finite, one sign everywhere, or a border of both signs.
    """
    if not np.isfinite(field).all():
        raise AssetError(f"{where}: sdf has values that are not finite numbers. Generate it again.")
    if not (field < 0).any() or not (field > 0).any():
        raise AssetError(f"{where}: the level set is empty, sdf has one sign everywhere. Generate it again.")
    negative = float((field[border(field.shape)] < 0).mean())
    if AMBIGUOUS_SHARE < negative < 1 - AMBIGUOUS_SHARE:
        raise AssetError(
            f"{where}: sdf is negative on {negative:.0%} of the border of its grid, so neither side is the outside. "
            "Is the order of the samples x, y, z?"
        )
    return -field if negative > 0.5 else field


def sealed(phi: np.ndarray) -> tuple[np.ndarray, dict[str, int]]:
    """``phi`` with enclosed cavities filled and what reaches the border cut off there; and how many samples.

    Outside is what is connected to the border. A generator whose sparse grid covers the neighbourhood of the surface
    only leaves the interior of an object empty; printed, it is solid.
    """
    edge = border(phi.shape)
    cut = edge & (phi < 0)
    phi = np.where(cut, -phi, phi)
    outside, _ = regions(phi >= 0)
    cavity = (phi >= 0) & ~np.isin(outside, np.unique(outside[edge]))
    least = np.abs(phi[phi != 0]).min(initial=1.0)
    phi = np.where(cavity, -np.maximum(phi, least), phi)
    return phi, {"samples_cut_off": int(cut.sum()), "samples_filled": int(cavity.sum())}


def without_small_components(phi: np.ndarray, share: float = SMALL_COMPONENT_SHARE) -> tuple[np.ndarray, int]:
    """``phi`` with components below ``share`` removed and cavities filled; and how many of both."""
    inside, count = regions(phi < 0)
    sizes = np.bincount(inside.reshape(-1), minlength=count + 1)
    sizes[0] = sizes.sum()
    small = sizes < share * (phi < 0).sum()
    phi = np.where(small[inside], -phi, phi)
    outside, cavities = regions(phi >= 0)
    cavity = (outside > 0) & (outside != outside[0, 0, 0])
    least = np.abs(phi[phi != 0]).min(initial=1.0)
    phi = np.where(cavity, -np.maximum(phi, least), phi)
    return phi, int(small.sum()) + max(0, cavities - 1)


def scaled(phi: np.ndarray) -> np.ndarray:
    """``phi`` times the factor that makes its median slope beside the surface one per grid unit.

    A factor does not move the surface, not even with weights. ``phi`` must be positive on the border.
    """
    inside = phi < 0
    neighbours = [np.roll(inside, step, axis) for axis in range(3) for step in (-1, 1)]
    index = np.argwhere(inside & ~np.logical_and.reduce(neighbours))
    centre, steps = phi[tuple(index.T)], np.eye(3, dtype=int)
    rise = [[phi[tuple((index + sign * step).T)] - centre for sign in (-1, 1)] for step in steps]
    cell = 2 / (len(phi) - 1)
    # The steeper side of each axis: at a wall of one sample a central difference vanishes
    return (phi / np.median(np.linalg.norm(np.abs(rise).max(axis=1), axis=0) / cell)).astype(np.float32)


def rotated(
    rotation: np.ndarray,
    phi: np.ndarray,
    deformation: np.ndarray | None,
    weights: np.ndarray | None,
    rows: np.ndarray | None,
) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | None, np.ndarray | None]:
    """A grid in a frame whose axes are ± those of the old one: new position = ``rotation [3,3]`` @ old position.

    The columns of α and β are permuted as the corners and edges of the cubes are.

    Args:
        rotation: a signed permutation matrix.
        phi: ``[m,m,m]``.
        deformation: ``[m,m,m,3]`` or None.
        weights: ``[n³,21]``, or ``[K,21]`` with ``rows``, or None.
        rows: ``[n³]`` or None.
    """
    axes = np.abs(rotation).argmax(axis=1)  # of the old frame, for each of the new
    signs = rotation[np.arange(3), axes]
    mirrored = tuple(np.flatnonzero(signs < 0).tolist())

    def transformed(array: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(np.flip(array.transpose(*axes, *range(3, array.ndim)), mirrored))

    def old_corner(new: int) -> int:
        bits = [new >> k & 1 ^ int(signs[k] < 0) for k in range(3)]
        return sum(bit << int(axis) for bit, axis in zip(bits, axes, strict=True))

    n = len(phi) - 1
    if deformation is not None:
        deformation = transformed(deformation)[..., axes] * signs.astype(np.float32)
    if weights is not None:
        edges = [edge_between(old_corner(a), old_corner(b)) for a, b in EDGES]
        columns = [*edges, *(12 + old_corner(corner) for corner in range(8)), 20]
        weights = weights[:, columns]
        if rows is None:
            weights = transformed(weights.reshape(n, n, n, 21)).reshape(-1, 21)
        else:
            rows = transformed(rows.reshape(n, n, n)).reshape(-1)
    return transformed(phi), deformation, weights, rows

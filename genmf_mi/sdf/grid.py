"""What has to be done to a generator's grid before it is an :class:`SdfAsset`: sign, border, cavities, axes, scale."""

from __future__ import annotations

import numpy as np

from genmf_mi.core.errors import AssetError
from genmf_mi.sdf.cube_cases import EDGES

UNCLEAR = 0.1
"""Share of the border that may be inside: the object is cut off there. With more the outside is not to be told."""


def border(shape: tuple[int, ...]) -> np.ndarray:
    """Mask of the outermost samples of a grid."""
    mask = np.ones(shape, dtype=bool)
    mask[1:-1, 1:-1, 1:-1] = False
    return mask


def outside_positive(field: np.ndarray, where: str) -> np.ndarray:
    """``field [m,m,m]`` or its negative, whichever is positive on the border, since nothing reaches out of the grid.

    Raises:
        AssetError: numbers that are none, one sign everywhere, or a border of both signs.
    """
    if not np.isfinite(field).all():
        raise AssetError(f"{where}: sdf has numbers that are none (NaN or infinite). Generate it again.")
    if not (field < 0).any() or not (field > 0).any():
        raise AssetError(f"{where}: the level set is empty, sdf has one sign everywhere. Generate it again.")
    negative = float((field[border(field.shape)] < 0).mean())
    if UNCLEAR < negative < 1 - UNCLEAR:
        raise AssetError(
            f"{where}: sdf is negative on {negative:.0%} of the border of its grid, so neither side is the outside. "
            "Is the order of the samples x, y, z?"
        )
    return -field if negative > 0.5 else field


def sealed(phi: np.ndarray) -> tuple[np.ndarray, dict[str, int]]:
    """``phi`` with what is inside of it filled and what reaches the border cut off there; and how many samples.

    Outside is what can be reached from the border. A generator whose sparse grid knows the neighbourhood of the surface
    only leaves the depth of a body empty; printed, it is solid.
    """
    from scipy.ndimage import label

    edge = border(phi.shape)
    cut = edge & (phi < 0)
    phi = np.where(cut, -phi, phi)
    regions, _ = label(phi >= 0)
    cavity = (phi >= 0) & ~np.isin(regions, np.unique(regions[edge]))
    least = np.abs(phi[phi != 0]).min(initial=1.0)
    phi = np.where(cavity, -np.maximum(phi, least), phi)
    return phi, {"samples_cut_off": int(cut.sum()), "samples_filled": int(cavity.sum())}


SPECK = 0.01
"""A separate body of a smaller share of the samples inside is left out."""


def without_specks(phi: np.ndarray, share: float = SPECK) -> tuple[np.ndarray, int]:
    """``phi`` with separate bodies below ``share`` emptied and cavities filled; and how many bodies and cavities."""
    from scipy.ndimage import label

    inside, count = label(phi < 0)
    sizes = np.bincount(inside.reshape(-1), minlength=count + 1)
    sizes[0] = sizes.sum()
    small = sizes < share * (phi < 0).sum()
    phi = np.where(small[inside], -phi, phi)
    outside, cavities = label(phi >= 0)
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
    at = np.argwhere(inside & ~np.logical_and.reduce(neighbours))
    here, steps = phi[tuple(at.T)], np.eye(3, dtype=int)
    rise = [[phi[tuple((at + sign * step).T)] - here for sign in (-1, 1)] for step in steps]
    cell = 2 / (len(phi) - 1)
    # The steeper side of each axis: about a wall of one sample a central difference vanishes
    return (phi / np.median(np.linalg.norm(np.abs(rise).max(axis=1), axis=0) / cell)).astype(np.float32)


def turned(
    rotation: np.ndarray,
    phi: np.ndarray,
    deformation: np.ndarray | None,
    weights: np.ndarray | None,
    rows: np.ndarray | None,
) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | None, np.ndarray | None]:
    """A grid in a frame whose axes are ± those of the old one: new position = ``rotation [3,3]`` @ old position.

    α and β keep to their corners and edges: their columns change places as these do.
    """
    axes = np.abs(rotation).argmax(axis=1)  # of the old frame, for each of the new
    signs = rotation[np.arange(3), axes]
    mirrored = tuple(np.flatnonzero(signs < 0))

    def moved(array: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(np.flip(array.transpose(*axes, *range(3, array.ndim)), mirrored))

    def old_corner(new: int) -> int:
        bits = [new >> k & 1 ^ int(signs[k] < 0) for k in range(3)]
        return sum(bit << int(axis) for bit, axis in zip(bits, axes, strict=True))

    n = len(phi) - 1
    if deformation is not None:
        deformation = moved(deformation)[..., axes] * signs.astype(np.float32)
    if weights is not None:
        edges = [EDGES.index(tuple(sorted((old_corner(a), old_corner(b))))) for a, b in EDGES]
        columns = [*edges, *(12 + old_corner(corner) for corner in range(8)), 20]
        weights = weights[:, columns]
        if rows is None:
            weights = moved(weights.reshape(n, n, n, 21)).reshape(-1, 21)
        else:
            rows = moved(rows.reshape(n, n, n)).reshape(-1)
    return moved(phi), deformation, weights, rows

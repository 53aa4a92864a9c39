"""InstantMesh (Xu et al. 2024): the raw outputs of its geometry decoder on a dense grid.

The grid has 128 cells per axis, spans ± scale / 2 with the scale 2.1, and is z up with the object looking along +x.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from genmf_mi.assets.sdf_asset import SdfAsset
from genmf_mi.core.errors import AssetError
from genmf_mi.sdf import grid

SCALE, SPREAD, DEFORMATION_DIVISOR = 2.1, 0.5, 4.0
TO_Y_UP = np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0]])
"""Up along y and the front along z, as in the GLB files of InstantMesh's own application."""


def build(
    name: str,
    sdf: np.ndarray,
    deformation: np.ndarray | None = None,
    weights: np.ndarray | None = None,
    *,
    scale: float = SCALE,
    source: Path | None = None,
) -> SdfAsset:
    """The :class:`SdfAsset` of the raw outputs.

    Args:
        sdf: ``[m³]`` or ``[m,m,m]``, x slowest, with axes of length one anywhere. Either sign: see
            :func:`grid.outside_positive`.
        deformation: ``[m³,3]``, before tanh; the samples are displaced by at most 1 / (4 n), whatever the scale.
        weights: ``[n³,21]``.
        scale: the side of the grid.

    Raises:
        AssetError: an array does not fit the grid or has values that are not finite, or there is no level set.
    """
    where = str(source or name)
    values = np.asarray(sdf, dtype=np.float32)
    m = round(values.size ** (1 / 3))
    if m**3 != values.size or {*values.shape} - {1, m, m**3} or m < 4:
        raise AssetError(f"{where}: sdf of shape {values.shape} is not a cubic grid; InstantMesh has 129³ samples.")
    if not scale > 0:
        raise AssetError(f"{where}: scale must be positive, not {scale}.")
    n = m - 1
    deformation = _shaped(where, "deformation", deformation, (m**3, 3), (m, m, m, 3))
    weights = _shaped(where, "weights", weights, (n**3, 21), (n**3, 21))
    phi, report = grid.sealed(grid.outside_positive(values.reshape(m, m, m), where))
    if deformation is not None:
        deformation = np.tanh(deformation) / (n * DEFORMATION_DIVISOR) / (scale / 2)
    phi, deformation, weights, _ = grid.rotated(TO_Y_UP, grid.scaled(phi), deformation, weights, None)
    return SdfAsset(name, phi, deformation, weights, spread=SPREAD, half=float(scale) / 2, source=source, report=report)


def _shaped(where: str, name: str, array: np.ndarray | None, flat: tuple, shape: tuple) -> np.ndarray | None:
    """``array`` in the shape ``shape``; it may be ``flat`` and have axes of length one anywhere."""
    if array is None:
        return None
    array = np.asarray(array, dtype=np.float32)
    squeezed = tuple(size for size in array.shape if size != 1)
    if squeezed not in (flat, shape):
        raise AssetError(f"{where}: {name} of shape {array.shape} does not fit sdf; it must be {flat}.")
    if not np.isfinite(array).all():
        raise AssetError(f"{where}: {name} has values that are not finite numbers. Generate it again.")
    return array.reshape(shape)

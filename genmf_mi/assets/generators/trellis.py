"""TRELLIS (Xiang et al. 2024), Hi3DGen and Stable3DGen: the sparse cubes that their mesh decoder hands to FlexiCubes.

A sparse structure of 64³ is subdivided twice into 256 cells per axis, of which only those near the surface have
features. The grid spans ± 1/2 and is z up. The channels of a cube are: Φ at its 8 corners, the displacement of these
(8 × 3, before tanh), 21 weights, and, if the decoder predicts them, colour and normal at the corners (8 × 6, logits).
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from genmf_mi.assets.asset import Asset
from genmf_mi.assets.sdf_asset import MAX_SAMPLES, SdfAsset
from genmf_mi.core.colour import to_linear
from genmf_mi.core.errors import AssetError
from genmf_mi.sdf import grid

RESOLUTION, SPREAD = 256, 0.99
PLAIN, COLOURED = 8 + 24 + 21, 8 + 24 + 21 + 48
"""Channels of a cube without and with colours."""
TO_Y_UP = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])
"""The rotation that TRELLIS itself applies to the GLB files that it writes."""


def build(
    name: str, coords: np.ndarray, feats: np.ndarray, *, resolution: int = RESOLUTION, source: Path | None = None
) -> SdfAsset:
    """The :class:`SdfAsset` of sparse cubes; shared corners take the mean, everything else is empty space.

    Args:
        coords: integer ``[K,3]``, x, y, z of each cube; or ``[K,4]`` with the number of the batch, all zero, first.
        feats: ``[K,53]`` or ``[K,101]``, before the extractor modifies them.

    Raises:
        AssetError: cubes outside of the grid or listed twice, another number of channels, values that are not finite,
            or no level set.
    """
    where, n = str(source or name), int(resolution)
    coords, feats = np.asarray(coords), np.asarray(feats, dtype=np.float32)
    if not 4 <= n < MAX_SAMPLES:
        raise AssetError(f"{where}: a resolution of {n} cells is out of range; TRELLIS has {RESOLUTION}.")
    if coords.ndim == 2 and coords.shape[1] == 4 and not coords[:, 0].any():
        coords = coords[:, 1:]
    if coords.ndim != 2 or coords.shape[1] != 3 or not np.issubdtype(coords.dtype, np.integer) or len(coords) == 0:
        raise AssetError(
            f"{where}: coords must be whole numbers [K,3] of one object, not {coords.dtype} {coords.shape}."
        )
    if coords.min() < 0 or coords.max() >= n:
        raise AssetError(
            f"{where}: coords reach from {coords.min()} to {coords.max()}, outside of a grid of {n} cells."
        )
    if feats.ndim != 2 or len(feats) != len(coords) or feats.shape[1] not in (PLAIN, COLOURED):
        raise AssetError(
            f"{where}: feats of shape {feats.shape} do not fit; {len(coords)} cubes have {PLAIN} channels "
            f"(8 sdf, 24 deformation, 21 weights) or {COLOURED} (and 48 colour)."
        )
    if not np.isfinite(feats).all():
        raise AssetError(f"{where}: feats have values that are not finite numbers. Generate it again.")
    coords = coords.astype(np.int64)
    cube = grid.flat_index(coords, n)
    rows = np.full(n**3, -1, dtype=np.int32)
    rows[cube] = np.arange(len(cube), dtype=np.int32)
    if (rows[cube] != np.arange(len(cube))).any():
        raise AssetError(f"{where}: coords name the same cube twice.")

    m = n + 1
    corners = coords[:, None] + [[c & 1, c >> 1 & 1, c >> 2] for c in range(8)]
    sample = grid.flat_index(corners.reshape(-1, 3), m)
    known, inverse = np.unique(sample, return_inverse=True)
    sample = inverse.reshape(-1)
    number = np.bincount(sample)

    def mean(channels: np.ndarray) -> np.ndarray:
        """From corners ``[8K,c]`` to samples ``[A,c]``."""
        return np.stack([np.bincount(sample, column) / number for column in channels.T], axis=1).astype(np.float32)

    field = np.ones(m**3, dtype=np.float32)
    field[known] = mean(feats[:, :8].reshape(-1, 1))[:, 0] - 1 / n  # the decoder's own bias
    deformation = np.zeros((m**3, 3), dtype=np.float32)
    deformation[known] = np.tanh(mean(feats[:, 8:32].reshape(-1, 3))) / n  # half a cell
    phi, report = grid.sealed(grid.outside_positive(field.reshape(m, m, m), where))
    parts = grid.rotated(TO_Y_UP, grid.scaled(phi), deformation.reshape(m, m, m, 3), feats[:, 32:53], rows)
    shape = SdfAsset(name, *parts, spread=SPREAD, half=0.5, source=source, report=report)
    if feats.shape[1] == PLAIN:
        return shape
    logits = mean(feats[:, 53:].reshape(-1, 6)[:, :3])
    vertices, faces = shape.surface(training=True)
    colours = _colours(vertices @ TO_Y_UP, known, logits, n)  # points are rows, so this is the inverse rotation
    return replace(shape, coloured=Asset.from_arrays(name, vertices, faces, colours=colours))


def _colours(points: np.ndarray, known: np.ndarray, logits: np.ndarray, n: int) -> np.ndarray:
    """Linear RGB ``[N,3]`` at ``points [N,3]`` in the generator's frame, trilinear over the ``known`` samples.

    known: ``[A]``, ascending indices into the flattened grid. logits: ``[A,3]``.
    """
    place = np.clip((points + 0.5) * n, 0, n - 1e-6)
    low = np.floor(place).astype(np.int64)
    total, weight = np.zeros((len(points), 3)), np.zeros(len(points))
    for c in range(8):
        step = np.array([c & 1, c >> 1 & 1, c >> 2])
        share = np.where(step, place - low, 1 - (place - low)).prod(axis=1)
        sample = grid.flat_index(low + step, n + 1)
        row = np.searchsorted(known, sample).clip(max=len(known) - 1)
        share = np.where(known[row] == sample, share, 0)
        total += share[:, None] * logits[row]
        weight += share
    return to_linear(1 / (1 + np.exp(-total / np.maximum(weight, 1e-9)[:, None])))

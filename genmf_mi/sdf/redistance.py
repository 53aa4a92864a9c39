"""A signed distance made exact again from its values near the surface."""

from __future__ import annotations

import numpy as np

from genmf_mi.sdf.distance import BAND

REACH_CELLS = 4.0
"""How many cells outside of the body a distance is of interest: what the air is like does not load a part."""


def redistance(phi: np.ndarray) -> np.ndarray:
    """Φ as it was before it was stored: away from the surface it is kept in steps of half a cell only.

    Every sample near the surface knows a surface point, x − Φ ∇Φ. The distance to the nearest of these replaces what
    is stored, inside and as far outside as the network looks. It differs from the true distance by a few hundredths of
    a cell, so that a network trained on it can be given a true distance.

    Args:
        phi: ``[n,n,n]`` from :func:`codec.unpack_distance`.

    Returns:
        float32 ``[n,n,n]``.
    """
    from scipy.spatial import cKDTree

    n = phi.shape[0]
    cell = 2.0 / (n - 1)
    phi = phi.astype(np.float64)
    band = np.abs(phi) < BAND * cell
    gradient = np.stack([g[band] for g in np.gradient(phi, cell)], axis=1)
    length = np.linalg.norm(gradient, axis=1)
    # Between two surfaces at one distance the differences say nothing; the samples about tell of both.
    sure = length > 0.95
    points = np.argwhere(band)[sure] * cell - 1.0 - (phi[band] / np.maximum(length, 1e-9))[sure, None] * gradient[sure]
    far = ~band & (phi < (REACH_CELLS + 1) * cell)
    if len(points) and far.any():
        tree = cKDTree(points, balanced_tree=False, compact_nodes=False)
        magnitude, _ = tree.query(np.argwhere(far) * cell - 1.0)
        phi[far] = np.copysign(magnitude, phi[far])
    return phi.astype(np.float32)

"""What can be predicted without a network: a constant, and a fit to thickness and curvature at the point.

A network that is not clearly better than these has learned nothing.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from genmf_mi.core.progress import Progress
from genmf_mi.stress.data.reader import StressSamples
from genmf_mi.stress.model.layers import GeometricGradient
from genmf_mi.stress.model.network import crop_box, to_stress, to_target
from genmf_mi.stress.training.metrics import Predict

RADII = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0)
"""Of the balls that local thickness is read from, in cells."""
FEATURES = 26
"""Columns of :func:`features`."""


def constant(samples: StressSamples) -> Predict:
    """The mean stress of all inner samples, everywhere."""
    total = count = 0.0
    for phi, stress in (samples[item] for item in range(len(samples))):
        total, count = total + float(stress[phi <= 0].sum()), count + int((phi <= 0).sum())
    return lambda phi, coarse: torch.full_like(phi, total / count)


def pointwise(samples: StressSamples, progress: Progress | None = None) -> Predict:
    """Least squares for log(1 + σ/k) on :func:`features`, all inner samples counting alike."""
    progress = progress or Progress()
    progress.stage("fitting")
    normal, right = np.zeros((FEATURES, FEATURES)), np.zeros(FEATURES)
    for item in range(len(samples)):
        phi, stress = samples[item]
        box = (slice(None), *crop_box(phi))
        target = to_target(stress[box])[phi[box] <= 0].double().numpy()
        matrix = features(phi[box], 2.0 / (phi.shape[-1] - 1))
        normal, right = normal + matrix.T @ matrix, right + matrix.T @ target
        progress.advance(item + 1, len(samples))
    weights = np.linalg.lstsq(normal, right, rcond=None)[0]

    def predict(phi: Tensor, coarse: Tensor | None) -> Tensor:
        box = (slice(None), *crop_box(phi))
        value = features(phi[box], 2.0 / (phi.shape[-1] - 1)) @ weights
        field = torch.zeros_like(phi)
        field[box][phi[box] <= 0] = to_stress(torch.from_numpy(value)).float()
        return field

    return predict


def features(phi: Tensor, cell: float) -> np.ndarray:
    """``[N,26]`` for the samples with Φ ≤ 0 of ``phi [1,X,Y,Z]``: 1, seven quantities and 18 products.

    Depth, local thickness, mean curvature, the vertical part of the normal, the height above the base and how near the
    base is, and the products of the first three with all of them.
    """
    inside = (phi[0] <= 0).numpy()
    _, _, vertical, _, laplacian = GeometricGradient(cell)(phi[None])[0].numpy()
    base = int(inside.any(axis=(0, 2)).argmax())
    height = np.broadcast_to((np.arange(inside.shape[1]) - base)[None, :, None], inside.shape)
    depth = -phi[0].numpy() / cell
    single = [
        np.log1p(depth.clip(0)),
        np.log1p(thickness(depth)),
        laplacian.clip(-3, 3),
        np.abs(vertical),
        height / 64,
        np.exp(-height / 2),
        np.exp(-height / 8),
    ]
    single = [field[inside] for field in single]
    products = [single[i] * single[j] for i in range(3) for j in range(i, len(single))]
    return np.stack([np.ones_like(single[0]), *single, *products], axis=1).astype(np.float64)


def thickness(depth: np.ndarray) -> np.ndarray:
    """Radius ``[X,Y,Z]``, in cells, of the largest ball of :data:`RADII` that is inside and holds the sample."""
    from scipy.ndimage import distance_transform_edt

    largest = np.maximum(depth, 0.0)
    for radius in RADII:
        centres = depth >= radius
        if not centres.any():
            break
        largest[np.asarray(distance_transform_edt(~centres)) <= radius] = radius
    return np.maximum(largest, depth)

"""Grain is smoothed, markings stay."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from loss_images import MASK, REFERENCE, SIZE, tensors

from genmf_mi.losses.bilateral import SIGMA, bilateral


def oracle(image, mask, contrast):
    """Pixel by pixel."""
    reach, out = round(2 * SIGMA), np.zeros_like(image)
    for b, y, x in np.argwhere(mask[:, 0] > 0):
        total = weights = 0.0
        own = image[b, 0, y, x] / max(mask[b, 0, y, x], 1e-3)
        for v in range(max(y - reach, 0), min(y + reach + 1, SIZE)):
            for u in range(max(x - reach, 0), min(x + reach + 1, SIZE)):
                other = image[b, 0, v, u] / max(mask[b, 0, v, u], 1e-3)
                away = ((v - y) ** 2 + (u - x) ** 2) / SIGMA**2 + ((other - own) / contrast) ** 2
                weight = mask[b, 0, v, u] * np.exp(-0.5 * away)
                total, weights = total + weight * other, weights + weight
        out[b, 0, y, x] = total / weights * mask[b, 0, y, x]
    return out


def test_value():
    smooth = bilateral(*tensors(REFERENCE * MASK, MASK), 0.1)
    np.testing.assert_allclose(smooth, oracle(REFERENCE * MASK, MASK, 0.1), atol=1e-9)


def test_grain_goes_and_edges_stay():
    mask = torch.ones(1, 1, 40, 40, dtype=torch.float64)
    grain = 0.01 * torch.tensor(np.random.default_rng(0).standard_normal((1, 1, 40, 40)))
    step = torch.full_like(mask, 0.3)
    step[..., 20:] = 0.7
    smooth = bilateral(step + grain, mask, 0.05)
    assert (smooth - step).std() < 0.3 * grain.std()
    assert smooth[..., 20:].mean() - smooth[..., :20].mean() == pytest.approx(0.4, abs=5e-3)
    assert (smooth[..., 20] - smooth[..., 19]).mean() == pytest.approx(0.4, abs=1e-2)


def test_nothing_of_the_background():
    image, mask = tensors(REFERENCE * MASK, MASK)
    assert (bilateral(image, mask, 0.1)[mask == 0] == 0).all()
    assert bilateral(torch.zeros_like(image), torch.zeros_like(mask), 0.1).abs().max() == 0

"""Images, masks and slow NumPy formulas that the tests of the losses share."""

from __future__ import annotations

import numpy as np
import torch
from scipy import ndimage


def smooth(shape: tuple[int, ...], seed: int, sigma: float = 1.5) -> np.ndarray:
    """Random images in 0..1 with some structure."""
    noise = np.random.default_rng(seed).standard_normal(shape)
    image = ndimage.gaussian_filter(noise, (*[0] * (len(shape) - 2), sigma, sigma))
    return 0.5 + 0.2 * image / image.std()


def disc(size: int, count: int = 1) -> np.ndarray:
    """Antialiased masks ``[B,1,H,W]`` of discs of different sizes."""
    y, x = np.mgrid[:size, :size] - (size - 1) / 2
    return np.stack([np.clip(size * (0.37 - 0.05 * i) - np.hypot(x - i, y), 0, 1)[None] for i in range(count)])


def unit(normals: np.ndarray) -> np.ndarray:
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


SIZE = 28
MASK = disc(SIZE, 2)
GREY, REFERENCE = smooth((2, 1, SIZE, SIZE), 0), smooth((2, 1, SIZE, SIZE), 1)
DEPTH, TEACHER_DEPTH = smooth((2, 1, SIZE, SIZE), 2), smooth((2, 1, SIZE, SIZE), 3)
NORMAL = unit(smooth((2, 3, SIZE, SIZE), 4) - 0.5)
TEACHER_NORMAL = unit(smooth((2, 3, SIZE, SIZE), 5) - 0.5)


def mean_inside(image: np.ndarray, mask: np.ndarray) -> float:
    """Mean of ``[B,C,H,W]`` weighted by ``[B,1,H,W]``, image by image, channel by channel."""
    means = [np.average(channel, weights=m[0]) for x, m in zip(image, mask, strict=True) for channel in x]
    return float(np.mean(means))


def gradients(image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sobel derivatives ``[B,1,H,W]`` along x and y, zeros beyond the border."""
    x = np.stack([ndimage.sobel(i[0], axis=1, mode="constant") / 8 for i in image])[:, None]
    y = np.stack([ndimage.sobel(i[0], axis=0, mode="constant") / 8 for i in image])[:, None]
    return x, y


def eroded(mask: np.ndarray, pixels: int = 1) -> np.ndarray:
    window = np.ones((2 * pixels + 1,) * 2)
    return np.stack([ndimage.binary_erosion(m[0] > 0.999, window, border_value=1) for m in mask])[:, None].astype(float)


def tensors(*arrays: np.ndarray) -> list[torch.Tensor]:
    return [torch.tensor(array) for array in arrays]

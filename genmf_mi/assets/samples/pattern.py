"""The functions that all samples are shaped and painted with. Values are arrays ``[N]``, colours sRGB in 0..1."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

_CELLS = 64  # lattice points per period
_FEATURE = 4  # lattice points per feature, so that linear interpolation looks smooth

Vector = np.ndarray | Sequence[float]


def rgb(code: str) -> np.ndarray:
    """``"b01020"`` to three floats."""
    return np.frombuffer(bytes.fromhex(code), np.uint8) / 255


def mix(a: np.ndarray, b: np.ndarray, amount: np.ndarray) -> np.ndarray:
    """From colours ``a`` (amount 0) to ``b`` (amount 1), ``[N,3]``; ``a`` and ``b`` may be one colour ``[3]``."""
    return a + (b - a) * np.asarray(amount)[..., None]


def ramp(value: np.ndarray, low: float, high: float) -> np.ndarray:
    """A smooth step from 0 at ``low`` to 1 at ``high``; falling if ``low > high``."""
    t = np.clip((value - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)


def inside(distance: np.ndarray, texel: float) -> np.ndarray:
    """Antialiased membership of the region ``distance < 0``: 1 inside, 0 outside, over two texels."""
    return ramp(distance, texel, -texel)


def union(a: np.ndarray, b: np.ndarray, radius: float) -> np.ndarray:
    """The field of the union of two solids, with a fillet of about ``radius`` (smooth minimum, Quilez 2013)."""
    h = np.maximum(radius - np.abs(a - b), 0) / radius
    return np.minimum(a, b) - h * h * radius / 4


def cut(a: np.ndarray, b: np.ndarray, radius: float) -> np.ndarray:
    """The field of the intersection of two solids, its edge rounded by about ``radius``."""
    return -union(-a, -b, radius)


def ellipsoid(points: np.ndarray, centre: Vector, axes: Vector) -> np.ndarray:
    """The field of an axis-aligned ellipsoid, near its surface about a distance."""
    axes = np.asarray(axes)
    local = (points - np.asarray(centre)) / axes
    length = np.linalg.norm(local, axis=-1)
    gradient = np.linalg.norm(local / axes, axis=-1)
    return length * (length - 1) / np.maximum(gradient, 1e-9)


def noise(points: np.ndarray, frequency: float, seed: int, octaves: int = 1) -> np.ndarray:
    """Smooth noise of 3D points ``[N,3]``: mean 0, standard deviation about 1, features of size ``1 / frequency``.

    Each further octave has twice the frequency and half the amplitude. Repeats after 16 features.
    """
    total = np.zeros(len(points))
    for octave in range(octaves):
        lattice = _lattice(seed + octave)
        coordinates = (points * (frequency * _FEATURE * 2**octave)).T
        total += map_coordinates(lattice, coordinates, order=1, mode="grid-wrap") / 2**octave
    return total / np.sqrt(sum(0.25**octave for octave in range(octaves)))


@cache
def _lattice(seed: int) -> np.ndarray:
    """A periodic block of smoothed white noise."""
    white = np.random.default_rng(seed).standard_normal((_CELLS,) * 3)
    smooth = gaussian_filter(white, _FEATURE / 2, mode="wrap")
    return smooth / smooth.std()

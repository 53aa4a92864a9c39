"""Colour spaces in one place: sRGB-encoded against linear RGB, and the value the paper prints.

Inside the package every colour is linear RGB with the sRGB/Rec. 709 primaries, range 0..1. Encoded numbers exist only
in files and in pictures meant for a screen.
"""

from __future__ import annotations

import numpy as np


def to_linear(encoded: np.ndarray) -> np.ndarray:
    """sRGB-encoded values in 0..1 (any shape) to linear float32 (IEC 61966-2-1)."""
    encoded = np.asarray(encoded, dtype=np.float32)
    return np.where(encoded <= 0.04045, encoded / 12.92, (np.maximum(encoded, 0.04045) + 0.055) ** 2.4 / 1.055**2.4)


def to_srgb(linear: np.ndarray) -> np.ndarray:
    """Linear values in 0..1 (any shape) to sRGB-encoded float32 (IEC 61966-2-1)."""
    linear = np.asarray(linear, dtype=np.float32)
    return np.where(linear <= 0.0031308, linear * 12.92, 1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055)


def bytes_to_linear(encoded: np.ndarray) -> np.ndarray:
    """sRGB bytes ``uint8`` (any shape) to linear float32, by table."""
    return _BYTES_TO_LINEAR[encoded]


def value(rgb: np.ndarray) -> np.ndarray:
    """V of HSV in linear light: the largest channel of linear ``[...,3]``, shape ``[...]``.

    It is taken before encoding, because the renderer multiplies it with light; a screen shows ``to_srgb`` of the
    product.
    """
    return np.asarray(rgb).max(axis=-1)


_BYTES_TO_LINEAR = to_linear(np.arange(256) / 255)

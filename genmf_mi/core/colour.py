"""Colour spaces in one place: sRGB-encoded against linear RGB, and the value the paper prints.

Inside the package every colour is linear RGB with the sRGB/Rec. 709 primaries, range 0..1. Encoded numbers exist only
in files and in images that are displayed or compared as they are displayed.

The transfer functions are those of IEC 61966-2-1. They take NumPy arrays and torch tensors, which they recognise
without importing torch. Values below 0 become 0. Gradients are finite everywhere: at 0 that of the linear part, below 0
zero.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

if TYPE_CHECKING:
    from torch import Tensor

Array = TypeVar("Array", np.ndarray, "Tensor")

_ENCODED_BREAK, _LINEAR_BREAK = 0.04045, 0.0031308
"""Up to here the curve is a straight line."""


def to_linear(encoded: Array) -> Array:
    """sRGB-encoded values in 0..1 to linear ones, any shape: float32 for NumPy, the tensor's own type for torch."""
    namespace, x = _floats(encoded)
    # The power never sees a value below the break, so that its gradient stays finite where the line is chosen
    curve = (x.clip(_ENCODED_BREAK) + 0.055) ** 2.4 / 1.055**2.4
    return namespace.where(x <= _ENCODED_BREAK, x.clip(0) / 12.92, curve)


def to_srgb(linear: Array) -> Array:
    """Linear values in 0..1 to sRGB-encoded ones, any shape: float32 for NumPy, the tensor's own type for torch."""
    namespace, x = _floats(linear)
    curve = 1.055 * x.clip(_LINEAR_BREAK) ** (1 / 2.4) - 0.055
    return namespace.where(x <= _LINEAR_BREAK, x.clip(0) * 12.92, curve)


def bytes_to_linear(encoded: np.ndarray) -> np.ndarray:
    """sRGB bytes ``uint8`` (any shape) to linear float32, by table."""
    return _BYTES_TO_LINEAR[encoded]


def numbers_to_linear(encoded: np.ndarray) -> np.ndarray:
    """sRGB-encoded numbers (any shape) to linear ones; of 0..255 if any is above 1, of 0..1 otherwise."""
    return to_linear(np.clip(encoded / 255 if encoded.max() > 1 else encoded, 0, 1))


def value(rgb: np.ndarray) -> np.ndarray:
    """V of HSV in linear light: the largest channel of linear ``[...,3]``, shape ``[...]``.

    It is taken before encoding, because the renderer multiplies it with light; a screen shows ``to_srgb`` of the
    product.
    """
    return np.asarray(rgb).max(axis=-1)


def _floats(values: Any) -> tuple[Any, Any]:
    """The module that has ``where`` for ``values``, and the values as floats."""
    torch = sys.modules.get("torch")  # a tensor can only come from a torch that is loaded
    if torch is not None and isinstance(values, torch.Tensor):
        return torch, values
    return np, np.asarray(values, dtype=np.float32)


_BYTES_TO_LINEAR = to_linear(np.arange(256) / 255)

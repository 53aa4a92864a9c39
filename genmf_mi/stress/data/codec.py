"""How a sample is packed: Φ and von Mises of a 129³ grid in about 0.3 MB.

Φ in three layers: every fourth sample, then the difference from their trilinear interpolation in steps of
:data:`FAR_STEP`, then, within :data:`BAND_CELLS` cells of the surface, what is still missing in steps of
:data:`NEAR_STEP`. Von Mises is kept in even steps of log(1 + σ/k): half a per cent of σ + k, a third of what a finer
mesh changes. It is differenced along the three axes before it is deflated.
"""

from __future__ import annotations

import numpy as np

COARSE_STEP = 2.0**-9
FAR_STEP = 2.0**-6
"""Φ far from the surface is kept to half of this: half a cell of the 129³ grid, 0.4 mm in a part of 100 mm."""
NEAR_STEP = 2.0**-10
"""Φ near the surface is kept to half of this: 1/32 of a cell, 0.026 mm."""
BAND_CELLS = 2.5
CODEC_SCALE_MPA = 0.5
"""k: below it the steps are even in σ, above it in log σ."""
STRESS_STEP = 1 / 96


def pack_distance(phi: np.ndarray) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """The layers of ``phi [n,n,n]``, and Φ as they give it back (float16): use that one from here on."""
    n = phi.shape[0]
    coarse = np.rint(phi[::4, ::4, ::4] / COARSE_STEP).astype(np.int16)
    base = COARSE_STEP * _enlarge(coarse, n)
    far = np.rint((phi - base) / FAR_STEP).astype(np.int8)
    rough = base + FAR_STEP * far
    band = _band(rough)
    near = np.rint((phi - rough)[band] / NEAR_STEP).astype(np.int8)
    layers = {"phi_coarse": _differences(coarse), "phi_far": far, "phi_near": near}
    return layers, unpack_distance(layers, n)


def unpack_distance(layers: dict[str, np.ndarray], n: int) -> np.ndarray:
    """Φ, float16 ``[n,n,n]``; n must be a multiple of four, plus one."""
    phi = COARSE_STEP * _enlarge(_sums(layers["phi_coarse"]), n) + FAR_STEP * layers["phi_far"]
    phi[_band(phi)] += NEAR_STEP * layers["phi_near"]
    return phi.astype(np.float16)


def pack_stress(field: np.ndarray, phi: np.ndarray) -> dict[str, np.ndarray]:
    """Von Mises in MPa ``[n,n,n]``, kept where ``phi`` ≤ 0, which must come from :func:`unpack_distance`."""
    inside = phi <= 0
    level = np.rint(np.log1p(np.where(inside, field, 0) / CODEC_SCALE_MPA) / STRESS_STEP).astype(np.int16)
    return {"von_mises": np.frombuffer(_planes(_differences(level)[_reach(inside)]), dtype=np.uint8)}


def unpack_stress(layers: dict[str, np.ndarray], phi: np.ndarray) -> np.ndarray:
    """Von Mises in MPa, float16 ``[n,n,n]``, zero outside."""
    inside = phi <= 0
    level = np.zeros(phi.shape, dtype=np.int16)
    level[_reach(inside)] = layers["von_mises"].reshape(2, -1).T.copy().view(np.int16)[:, 0]
    field = CODEC_SCALE_MPA * np.expm1(_sums(level) * np.float32(STRESS_STEP))
    return np.where(inside, field, 0).astype(np.float16)


def _differences(level: np.ndarray) -> np.ndarray:
    for axis in range(3):
        level = np.diff(level, axis=axis, prepend=np.int16(0))
    return level


def _sums(level: np.ndarray) -> np.ndarray:
    for axis in range(3):
        level = np.cumsum(level, axis=axis, dtype=np.int16)
    return level


def _enlarge(coarse: np.ndarray, n: int) -> np.ndarray:
    """Trilinear interpolation to ``[n,n,n]``, float32, one axis after the other."""
    field = coarse.astype(np.float32)
    position = np.linspace(0.0, coarse.shape[0] - 1.0, n)
    low = np.minimum(position.astype(np.int64), coarse.shape[0] - 2)
    weight = (position - low).astype(np.float32)
    for axis in range(3):
        shape = [1, 1, 1]
        shape[axis] = n
        w = weight.reshape(shape)
        field = np.take(field, low, axis) * (1 - w) + np.take(field, low + 1, axis) * w
    return field


def _band(phi: np.ndarray) -> np.ndarray:
    return np.abs(phi) < BAND_CELLS * 2.0 / (phi.shape[0] - 1)


def _reach(inside: np.ndarray) -> np.ndarray:
    """Where the differences of a field that vanishes outside can be other than zero: one sample on, on each axis."""
    reach = inside
    for axis in range(3):
        reach = reach | np.insert(np.delete(reach, -1, axis), 0, False, axis)
    return reach


def _planes(value: np.ndarray) -> bytes:
    """Low bytes, then high bytes: the high ones are nearly all alike."""
    return value.view(np.uint8).reshape(-1, 2).T.tobytes()

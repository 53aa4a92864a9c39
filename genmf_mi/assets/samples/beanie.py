"""A knitted bobble hat: stitches in rows and columns, snowflakes and zigzags of wool in three colours, a ribbed brim,
and a round patch with the logo of a mountain club."""

from __future__ import annotations

import numpy as np

from genmf_mi.assets.samples.charts import Chart, cube_sphere
from genmf_mi.assets.samples.pattern import cut, ellipsoid, inside, mix, noise, ramp, rgb, union

_DOME = (0, -0.12, 0), (0.395, 0.455, 0.395)
_BRIM = (0, -0.30, 0), (0.435, 0.155, 0.435)
_POMPON = (0, 0.385, 0), (0.125, 0.125, 0.125)
_FOOT = -0.40
_HEM = -0.185  # upper edge of the brim
_COLUMNS, _RIBS = 48, 24
_ROW = 0.0375
_PATCH = 0.118  # radius of the logo, whose middle is at the height below
_PATCH_AT = 0.035
_WOOL = {".": "f3ead6", "n": "1d2f5c", "r": "9f1d2b"}
_PATTERN = (
    "nnnnnnnnnnnn", "n.n.n.n.n.n.", "............", ".....r......", "r...rrr...r.", ".r.r.r.r.r..", "..rr.r.rr...",
    ".....r......", "..rr.r.rr...", ".r.r.r.r.r..", "r...rrr...r.", ".....r......", "............", ".n.n.n.n.n.n",
    "nnnnnnnnnnnn", "............", "n.....n.....", "nn...nnn...n", ".nn.nn.nn.nn", "..nnn...nnn.", "...n.....n..",
    "............",
)  # fmt: skip
"""Colours of the stitches from the brim upwards, one period around; the last row goes on to the top."""


def charts() -> list[Chart]:
    return cube_sphere(_field, stretch=(1, 1, 1))


def paint(points: np.ndarray, texel: float) -> np.ndarray:
    turn, y = np.arctan2(points[:, 0], points[:, 2]) / (2 * np.pi), points[:, 1]
    fuzz = noise(points, 12, 710, octaves=2)
    # A texture with fewer than some twenty texels per stitch shows the wool without them: they would only alias.
    plain = np.broadcast_to(rgb("d9cdb8"), points.shape)
    colour = mix(plain, _stitches(turn, y, points, fuzz), ramp(np.full(len(points), texel), 0.0034, 0.0022))
    ribs = np.abs(np.mod(turn * _RIBS, 1) - 0.5) * 2
    brim = mix(rgb("f3ead6"), rgb("5d6b8f"), ramp(ribs, 0.55, 0.8))
    brim = mix(brim, rgb("2a355a"), ramp(ribs, 0.85, 1.0))
    fold = np.abs(np.mod(y / 0.026, 1) - 0.5) * 2
    brim = brim * (1 - 0.14 * ramp(fold, 0.6, 1.0))[:, None]
    colour = mix(colour, brim, inside(y - _HEM, texel))
    colour = mix(colour, rgb("1b2445"), inside(np.abs(y - _HEM) - 0.008, texel))

    tuft = np.linalg.norm(points - np.array(_POMPON[0]), axis=1) - 0.15
    strands = noise(points * [1.6, 0.7, 1.6], 30, 730)
    wool = mix(rgb("f7efdd"), rgb("3b4670"), ramp(np.abs(strands), 0.45, 0.12))
    colour = mix(colour, wool, inside(np.maximum(tuft, 0.285 - y), texel))
    return _logo(colour, points, texel)


def _stitches(turn: np.ndarray, y: np.ndarray, points: np.ndarray, fuzz: np.ndarray) -> np.ndarray:
    """Plain knitting: each stitch is a V of two slanted strands, dark where they dip below their neighbours."""
    centre, axes = np.array(_DOME)
    angle = np.arctan2((y - centre[1]) / axes[1], np.hypot(points[:, 0], points[:, 2]) / axes[0])
    row = 0.43 * (angle - np.arcsin((_HEM - centre[1]) / axes[1])) / _ROW
    column = turn * _COLUMNS
    s = np.mod(column, 1) - 0.5  # across the stitch
    up = row - 1.15 * (0.5 - np.abs(s))  # the legs of the V rise outwards
    index, t = np.floor(up), np.mod(up, 1) - 0.5
    names = np.array([list(line) for line in _PATTERN])
    picked = names[np.clip(index, 0, len(names) - 1).astype(int), np.floor(column).astype(int) % names.shape[1]]
    colour = np.empty((len(y), 3))
    for name, code in _WOOL.items():
        colour[picked == name] = rgb(code)
    strand = np.hypot((np.abs(s) - 0.26) / 0.30, 0.78 * t / 0.5)
    depth = ramp(strand, 0.55, 1.1)
    twist = 0.5 + 0.5 * np.sin(11 * (np.abs(s) + 0.6 * t))
    shade = (1 - 0.05 * twist - 0.02 * fuzz.clip(-1.5, 1.5)) * (1 - 0.58 * depth)
    return (colour * shade[:, None]).clip(0, 1)


def _logo(colour: np.ndarray, points: np.ndarray, texel: float) -> np.ndarray:
    """Two peaks with snow under a sun in a ring, sewn on with dashes."""
    x, y = 0.385 * np.arctan2(points[:, 0], points[:, 2]), points[:, 1] - _PATCH_AT
    away = np.hypot(x, y) + np.where(points[:, 2] > 0, 0, 1)
    navy, cream, gold = rgb("16244d"), rgb("f6eedb"), rgb("f0b428")
    colour = mix(colour, navy, inside(away - _PATCH, texel))
    seam = np.abs(away - _PATCH + 0.011) - 0.0032
    dash = np.abs(np.mod(np.arctan2(x, y) / (2 * np.pi) * 40, 1) - 0.5) - 0.3
    colour = mix(colour, cream, inside(np.maximum(seam, 0.018 * dash), texel))
    disc = away - _PATCH + 0.022
    inner = np.broadcast_to(cream, colour.shape)
    sun = np.hypot(x - 0.030, y - 0.042)
    beams = np.abs(np.mod(np.arctan2(x - 0.030, y - 0.042) / (2 * np.pi) * 12, 1) - 0.5)
    beams = np.where((sun > 0.027) & (sun < 0.040), (0.2 - beams) * 0.02, 1)
    inner = mix(inner, gold, inside(np.minimum(sun - 0.021, beams), texel))
    inner = mix(inner, rgb("8a5a10"), inside(np.abs(sun - 0.021) - 0.0025, texel))
    for top, place, steep in ((0.020, 0.040, 1.15), (0.052, -0.022, 1.25)):
        peak = (y - top + steep * np.abs(x - place)) / np.hypot(1, steep)
        inner = mix(inner, cream, inside(peak - 0.005, texel))
        inner = mix(inner, navy, inside(peak, texel))
        zigzag = 0.010 * np.abs(np.mod((x - place) / 0.017 + 0.5, 1) - 0.5) * 2
        snow = np.maximum(peak + 0.006, top - 0.034 - y + zigzag)
        inner = mix(inner, cream, inside(snow, texel))
    ground = y + 0.052 + 0.006 * np.cos(x * 70)
    inner = mix(inner, cream, inside(np.abs(ground) - 0.0045, texel))
    inner = mix(inner, rgb("9f1d2b"), inside(ground + 0.0045, texel))
    return mix(colour, inner, inside(disc, texel))


def _field(points: np.ndarray) -> np.ndarray:
    hat = union(ellipsoid(points, *_DOME), ellipsoid(points, *_BRIM), 0.03)
    hat = union(hat, ellipsoid(points, *_POMPON), 0.03)
    return cut(hat, _FOOT - points[:, 1], 0.03)

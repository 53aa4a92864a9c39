"""A leaf as a slab a twentieth of its length thick, gently bent: midrib, side veins and fine ones on both faces."""

from __future__ import annotations

import numpy as np

from genmf_mi.assets.samples.charts import Chart
from genmf_mi.assets.samples.pattern import inside, mix, noise, ramp, rgb, union

_THICKNESS = 0.026  # half of it
_BLADE = -0.40, 0.5  # where the blade begins and ends along x; before it is the stalk
_SPACING = 0.072  # of the side veins along the midrib


def charts() -> list[Chart]:
    """The upper and the lower face, which meet along the middle of the rounded rim."""
    quarter = np.linspace(0, np.pi / 2, 6)
    ends = _THICKNESS * (1 - np.cos(quarter))
    x = np.concatenate([ends - 0.5, np.linspace(ends[-1] - 0.5, 0.5 - ends[-1], 110)[1:-1], 0.5 - ends[::-1]])
    cap = np.concatenate([np.sin(quarter), np.ones(108), np.sin(quarter)[::-1]])
    half = _half_width(x) * (0.6 + 0.4 * cap)  # the corners of the outline are rounded, too
    rim = np.minimum(_THICKNESS, 0.9 * half)
    # Across, vertices follow each other evenly: up the rounded rim, over the face, down the other rim.
    # Sharper towards the ends, where the rim of the end takes over.
    curb = rim * np.maximum(cap**4, 0.01)
    quarter_arc = curb * np.pi / 2
    way = np.linspace(0, 1, 56)[:, None] * 2 * (half - curb + quarter_arc)
    back = way[::-1]
    short = np.minimum(way, back)
    angle = np.minimum(short / curb, np.pi / 2)
    inwards = curb * (1 - np.cos(angle)) + np.maximum(short - quarter_arc, 0)
    z = np.sign(back - way) * (half - inwards)  # v runs towards -z on the upper face
    bulge = np.sin(angle) * cap * rim
    x = np.broadcast_to(x, z.shape)
    middle = _bend(x, z)
    upper = np.stack([x, middle + bulge, z], axis=-1)
    lower = np.stack([x, middle - bulge, z], axis=-1)[::-1]
    return [Chart(upper, (0, 0.5, 1, 1)), Chart(lower, (0, 0, 1, 0.5))]


def paint(points: np.ndarray, texel: float) -> np.ndarray:
    x, z = points[:, 0], points[:, 2]
    above = (points[:, 1] > _bend(x, z))[:, None]
    margin = _half_width(x) - np.abs(z)
    mottle = noise(points, 7, 310, octaves=3)
    upper = mix(rgb("2a6c2c"), rgb("3a8433"), ramp(mottle, -1.5, 1.5))
    lower = mix(rgb("467a42"), rgb("578c4d"), ramp(mottle, -1.5, 1.5))
    blade = np.where(above, upper, lower)
    pale = np.where(above, rgb("e0eaa4"), rgb("eef2cc"))

    side, fine = _veins(points)
    rib = np.abs(z) - 0.013 * ramp(x, 0.7, -0.5) - 0.002
    blade = mix(blade, blade * 0.72, ramp(np.minimum(side, rib), 0.015, 0.002))
    blade = mix(blade, pale, 0.5 * inside(fine, texel) * ramp(margin, 0.01, 0.03))
    blade = mix(blade, pale, inside(side, texel))
    blade = mix(blade, rgb("b4cb74"), ramp(margin, 0.014, 0.006))
    stalk = mix(mix(pale, rgb("c3cf86"), ramp(x, _BLADE[0] + 0.05, _BLADE[0])), rgb("a38f58"), ramp(x, -0.44, -0.50))
    return mix(blade, stalk, np.maximum(inside(rib, texel), ramp(x, _BLADE[0] + 0.03, _BLADE[0] - 0.01)))


def _half_width(x: np.ndarray) -> np.ndarray:
    """Half the width of the outline at ``x``: a stalk, an egg-shaped blade and a drawn-out, blunt tip."""
    u = np.clip((x - _BLADE[0]) / (_BLADE[1] - _BLADE[0]), 0, 1)
    blade = 0.92 * u**0.75 * (1 - u) ** 1.15
    return -union(-blade, -np.where(x < 0, 0.026, 0.014), 0.02)


def _bend(x: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Height of the middle of the slab: arched along the midrib, its halves raised a little and wavy."""
    waves = 0.22 * z**2 * np.sin(15 * x + np.where(z > 0, 0.0, 1.3))
    return 0.11 * x**2 + 0.12 * np.maximum(x, 0) ** 2 + 0.40 * z**2 + waves


def _veins(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distances to the side veins and to the net of fine veins between them, seen from above."""
    x, z = points[:, 0], points[:, 2]
    away = np.abs(z)
    other = np.where(z > 0, 0.0, 0.5)  # the veins of the two sides alternate
    # Side veins are level lines of `along`, bent towards the tip as they go out.
    along = (x - _BLADE[0] - 0.02 - 0.50 * away - 1.7 * away**2) / _SPACING + other
    slope = np.hypot(1, 0.50 + 3.4 * away)
    number = np.round(along)
    reach = np.clip(away / _half_width(x), 0, 1)
    side = _SPACING * np.abs(along - number) / slope - 0.0062 * (1 - 0.7 * reach)
    side = np.where((number >= 0) & (reach < 0.95), side, 1)

    # Rungs between two side veins; each ladder is shifted against the next.
    ladder = np.floor(along)
    shift = np.sin(12.9 * ladder + 4.1 * other) + 0.28 * noise(points, 16, 320)
    rung = (away + 0.2 * (x - 0.5 * away)) / 0.033 + shift
    return side, 0.033 * np.abs(rung - np.round(rung)) - 0.0019

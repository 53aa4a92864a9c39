"""A plaque with what is hard to read in one colour: letters of 8, 5 and 3 mm, a pair of eyes, a line drawing.

The sizes are those of a part of 100 mm. The rim is dark, the back is plain.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from PIL import Image, ImageDraw, ImageFont
from scipy.ndimage import map_coordinates

from genmf_mi.assets.samples.charts import Chart, cube_sphere
from genmf_mi.assets.samples.pattern import cut, inside, mix, noise, ramp, rgb

_HALF = 0.5, 0.36, 0.13
_FOOT = -0.32
_MM = 0.01
_PER_MM = 24
"""Pixels of the drawing."""

REGIONS: dict[str, tuple[float, float, float, float]] = {
    "letters of 8 mm": (-40, 12, 12, 24),
    "letters of 5 mm": (-40, 0, 12, 9),
    "letters of 3 mm": (-40, -10, 12, -3),
    "eyes": (14, 6, 41, 24),
    "drawing": (14, -27, 41, 4),
}
"""Left, bottom, right and top of each motif on the front, in mm from its middle."""
_LINES = (("RELIEF", 8.0, 14.0), ("Owl & Fern 25", 5.0, 2.0), ("printed in one colour", 3.0, -8.0))
"""Text, height of its capitals and its base line, in mm."""
_RULE = (-40.0, -15.0), (10.0, -15.0)


def charts() -> list[Chart]:
    boxes = [
        (0, 0.5, 0.76, 1), (0.76, 0.75, 1, 1), (0, 0, 0.76, 0.5),
        (0.76, 0.5, 1, 0.75), (0.76, 0.25, 1, 0.5), (0.76, 0, 1, 0.25),
    ]  # fmt: skip
    return [replace(c, box=box) for c, box in zip(cube_sphere(_field, stretch=_HALF), boxes, strict=True)]


def paint(points: np.ndarray, texel: float) -> np.ndarray:
    grain = noise(points, 5, 60, octaves=2)
    cream = mix(rgb("f2e9d5"), rgb("ece1c9"), ramp(grain, -1.5, 1.5))
    drawing = np.asarray(_drawing(), dtype=np.float64) / 255
    height, width = drawing.shape
    column = (points[:, 0] / (2 * _HALF[0]) + 0.5) * width - 0.5
    row = (0.5 - points[:, 1] / (2 * _HALF[1])) * height - 0.5
    ink = map_coordinates(drawing, [row, column], order=1, mode="nearest") * (points[:, 2] > 0.5 * _HALF[2])
    rim = inside(np.abs(points[:, 2]) - 0.35 * _HALF[2], texel)
    return mix(cream, rgb("23272d"), np.maximum(ink, rim))


def _field(points: np.ndarray) -> np.ndarray:
    """A pillow with round edges, cut flat at the foot."""
    ratio = np.abs(points) / _HALF
    pillow = ((ratio[:, 0] ** 8 + ratio[:, 1] ** 8) ** 0.5 + ratio[:, 2] ** 4) ** 0.25 - 1
    return cut(pillow * min(_HALF), _FOOT - points[:, 1], 0.008)


@cache
def _drawing() -> Image.Image:
    """The ink on the front, 255 where it is: ``_PER_MM`` pixels per mm, y down."""
    width, height = (round(2 * half / _MM * _PER_MM) for half in _HALF[:2])
    image = Image.new("L", (width, height))
    draw = ImageDraw.Draw(image)
    for text, capital, base in _LINES:
        draw.text(_pixel(-40, base), text, fill=255, font=_font(capital), anchor="ls")
    draw.line([_pixel(*end) for end in _RULE], fill=255, width=round(0.8 * _PER_MM))
    for x in (20.5, 34.5):
        _disc(draw, x, 15, 6.0, 255)
        _disc(draw, x, 15, 5.2, 0)
        _disc(draw, x + 0.4, 14.6, 3.2, 255)
        _disc(draw, x - 0.8, 16.0, 1.0, 0)
    _fern(draw, 27.5, -26.5)
    return image


def _fern(draw: ImageDraw.ImageDraw, x: float, y: float) -> None:
    """A frond in strokes of 0.6 mm: a stem and pairs of curved leaves that get shorter upwards."""
    width = round(0.6 * _PER_MM)
    draw.line([_pixel(x, y), _pixel(x, y + 29)], fill=255, width=width)
    for i in range(8):
        foot, length = y + 3 + 3.2 * i, 12.5 - 1.3 * i
        for side in (-1, 1):
            t = np.linspace(0, 1, 12)
            leaf = [(x + side * length * s, foot + 3.2 * s - 3.0 * s * (1 - s)) for s in t]
            draw.line([_pixel(*point) for point in leaf], fill=255, width=width, joint="curve")
            _disc(draw, *leaf[-1], 0.7, 255)


def _disc(draw: ImageDraw.ImageDraw, x: float, y: float, radius: float, fill: int) -> None:
    (left, bottom), (right, top) = _pixel(x - radius, y - radius), _pixel(x + radius, y + radius)
    draw.ellipse((left, top, right, bottom), fill=fill)


def _pixel(x: float, y: float) -> tuple[float, float]:
    return (x + _HALF[0] / _MM) * _PER_MM, (_HALF[1] / _MM - y) * _PER_MM


def _font(capital_mm: float) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """The font that Pillow contains, in the size whose capitals have that height."""
    size = capital_mm * _PER_MM
    for _ in range(3):
        box = ImageFont.load_default(size).getbbox("H", anchor="ls")
        size *= capital_mm * _PER_MM / (box[3] - box[1])
    return ImageFont.load_default(size)

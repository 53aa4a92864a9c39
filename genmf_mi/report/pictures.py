"""Linear renders to pictures for a screen: one exposure, one backdrop, one relief colour scale.

Everything is composed in linear light with the coverage as alpha and encoded once at the end, so that silhouettes stay
smooth and before and after can be compared by eye.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from functools import lru_cache
from io import BytesIO
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from genmf_mi.core.colour import to_linear, to_srgb
from genmf_mi.core.errors import OutputError
from genmf_mi.core.files import atomic
from genmf_mi.report.model import View

PLASTIC = (0.92, 0.88, 0.825)
"""Tint of the one-colour renders, linear RGB: matt PLA in a warm light grey."""

RELIEF_COLOURS = ("#053061", "#2166ac", "#4393c3", "#92c5de", "#f7f7f7", "#f4a582", "#d6604d", "#b2182b", "#67001f")
"""Sunken to raised, evenly spaced: ColorBrewer's RdBu, reversed."""

_BACKDROP = to_linear(np.array([[0.49, 0.50, 0.52], [0.31, 0.32, 0.34]]))  # middle, corners
_PAPER, _INK, _FAINT = (250, 249, 247), (32, 33, 36), (106, 108, 112)
_WIDTH, _MARGIN, _GAP = 2000, 56, 24


def relief_colour(relief_mm: np.ndarray, range_mm: float) -> np.ndarray:
    """Signed relief ``[...]`` in mm to sRGB-encoded ``[...,3]``; the scale ends at ±``range_mm``, NaN reads as 0."""
    anchors = np.array([[int(c[i : i + 2], 16) / 255 for i in (1, 3, 5)] for c in RELIEF_COLOURS])
    at = np.nan_to_num(np.asarray(relief_mm, dtype=np.float64)) / max(range_mm, 1e-9)
    at = (np.clip(at, -1, 1) + 1) / 2 * (len(anchors) - 1)
    return np.stack([np.interp(at, np.arange(len(anchors)), anchors[:, k]) for k in range(3)], axis=-1)


def relief_picture(view: View, range_mm: float) -> np.ndarray:
    """The relief map of a view, premultiplied linear RGB ``[H,W,3]``, lightly shaded so that the shape can be read."""
    mask = view.coverage("after")
    shade = view.after / np.maximum(mask, 1e-6)
    shade = 0.55 + 0.45 * np.clip(shade / max(float(np.quantile(shade, 0.99)), 1e-6), 0, 1)
    return to_linear(relief_colour(view.relief_mm, range_mm)) * (shade * mask)[..., None]


def plastic(grey: np.ndarray) -> np.ndarray:
    """A one-colour render ``[H,W]`` as the filament shows it, premultiplied linear RGB ``[H,W,3]``."""
    return grey[..., None] * np.asarray(PLASTIC, dtype=np.float32)


def compose(
    image: np.ndarray,
    mask: np.ndarray,
    box: tuple[int, int, int, int] | None = None,
    size: tuple[int, int] | None = None,
) -> Image.Image:
    """Lay a premultiplied linear image on the backdrop and encode it for a screen.

    Args:
        image: ``[H,W]`` or ``[H,W,3]``, premultiplied by ``mask`` ``[H,W]``.
        box: left, top, right, bottom in pixels to crop to; may reach beyond the image. Default: all of it.
        size: width and height of the picture; default: those of the box.
    """
    if image.ndim == 2:
        image = np.repeat(image[..., None], 3, axis=2)
    height, width = mask.shape
    box = box or (0, 0, width, height)
    size = size or (box[2] - box[0], box[3] - box[1])

    def fit(channel: np.ndarray) -> np.ndarray:
        cropped = Image.fromarray(np.nan_to_num(channel).astype(np.float32)).crop(box)
        return np.asarray(cropped if cropped.size == size else cropped.resize(size, Image.Resampling.BICUBIC))

    colour = np.stack([fit(image[..., k]) for k in range(3)], axis=2)
    alpha = np.clip(fit(mask), 0, 1)[..., None]
    pixels = to_srgb(np.clip(colour + (1 - alpha) * _backdrop(*size), 0, 1))
    return Image.fromarray(np.round(pixels * 255).astype(np.uint8))


def picture(
    view: View,
    kind: str,
    box: tuple[int, int, int, int] | None = None,
    size: tuple[int, int] | None = None,
) -> Image.Image:
    """One of a view's images by its field name, as a person should see it; ``box``, ``size`` as in :func:`compose`."""
    image, mask = getattr(view, kind), view.coverage(kind)
    return compose(plastic(image) if kind in ("before", "displacement", "after") else image, mask, box, size)


def framing(views: list[View], margin: float = 0.05, tallest: float = 1.25) -> tuple[int, int, int, int]:
    """The smallest box that holds the object in all ``views``: left, top, right, bottom in pixels.

    Args:
        margin: left free on every side, a share of the longer side of the object.
        tallest: the largest height over width; the box of a tall object is widened to it.
    """
    covered = np.any([view.mask > 0.05 for view in views], axis=0)
    rows, columns = np.flatnonzero(covered.any(axis=1)), np.flatnonzero(covered.any(axis=0))
    if not len(rows):
        return 0, 0, covered.shape[1], covered.shape[0]
    pad = round(margin * max(np.ptp(rows), np.ptp(columns))) + 1
    left, top, right, bottom = columns[0] - pad, rows[0] - pad, columns[-1] + 1 + pad, rows[-1] + 1 + pad
    widen = max(0, round(((bottom - top) / tallest - (right - left)) / 2))
    return int(left - widen), int(top), int(right + widen), int(bottom)


def by_change(views: list[View]) -> list[View]:
    """The views with the one where the refinement changed most first."""
    return sorted(views, key=lambda view: -float(np.abs(view.after - view.before).sum()))


def data_uri(picture: Image.Image, quality: int = 90) -> str:
    """A picture as a WebP ``data:`` URI."""
    buffer = BytesIO()
    picture.save(buffer, "WEBP", quality=quality, method=4)
    return "data:image/webp;base64," + base64.b64encode(buffer.getvalue()).decode("ascii")


def write_before_after(path: str | Path, views: list[View], title: str) -> None:
    """Write the picture to judge by: textured, printed as it is today, and refined, for the views that changed most.

    Raises:
        OutputError: there is no view, or the file cannot be written.
    """
    if not views:
        raise OutputError(f"cannot write {path}: there are no views to show. Render at least one view first.")
    columns = [
        ("Textured model", "what the file shows", "colour"),
        ("Printed as it is", "one colour, original shape", "before"),
        ("Refined", "one colour, texture as relief", "after"),
    ]
    chosen = by_change(views)[:3]
    box = framing(chosen)
    width = (_WIDTH - 2 * _MARGIN - (len(columns) - 1) * _GAP) // len(columns)
    height = round(width * (box[3] - box[1]) / (box[2] - box[0]))
    if height > 0.8 * width:
        chosen = chosen[:2]
    header, caption = 196, 44
    sheet = Image.new("RGB", (_WIDTH, header + len(chosen) * (height + caption) + _MARGIN - 8), _PAPER)
    draw, corners = ImageDraw.Draw(sheet), _rounded(width, height)
    draw.text((_MARGIN, 36), _shorten(draw, title, _font(44, True), _WIDTH - 2 * _MARGIN), _INK, _font(44, True))
    for column, (name, detail, kind) in enumerate(columns):
        x = _MARGIN + column * (width + _GAP)
        draw.text((x, 116), name, _INK, _font(29, True))
        draw.text((x, 153), detail, _FAINT, _font(23))
        for row, view in enumerate(chosen):
            y = header + row * (height + caption)
            sheet.paste(picture(view, kind, box, (width, height)), (x, y), corners)
            if column == 0:
                draw.text((x, y + height + 9), view.label, _FAINT, _font(20))
    with atomic(path) as temporary:
        sheet.save(temporary, "PNG")


def write_row(path: str | Path, pictures: Sequence[Image.Image], names: Sequence[str]) -> None:
    """Write pictures of one size side by side, each under its name.

    Raises:
        OutputError: the file cannot be written.
    """
    width, height, header, margin, gap = *pictures[0].size, 34, 12, 8
    sheet = Image.new("RGB", (2 * margin + len(pictures) * (width + gap) - gap, header + height + margin), _PAPER)
    draw = ImageDraw.Draw(sheet)
    for i, (picture, name) in enumerate(zip(pictures, names, strict=True)):
        x = margin + i * (width + gap)
        draw.text((x, 8), name, _INK, _font(16, True))
        sheet.paste(picture, (x, header))
    with atomic(path) as temporary:
        sheet.save(temporary, "PNG")


def write_rows(path: str | Path, rows: Mapping[str, Sequence[Image.Image]], names: Sequence[str]) -> None:
    """Write rows of pictures of one size, each row under its name, each column under its own.

    Raises:
        OutputError: the file cannot be written.
    """
    width, height = next(iter(rows.values()))[0].size
    header, title, margin, gap = 40, 30, 16, 8
    size = 2 * margin + len(names) * (width + gap) - gap, header + len(rows) * (title + height) + margin
    sheet = Image.new("RGB", size, _PAPER)
    draw = ImageDraw.Draw(sheet)
    for column, name in enumerate(names):
        draw.text((margin + column * (width + gap), 12), name, _INK, _font(17, True))
    for row, (name, pictures) in enumerate(rows.items()):
        y = header + row * (title + height)
        draw.text((margin, y + 6), name, _FAINT, _font(15))
        for column, picture in enumerate(pictures):
            sheet.paste(picture, (margin + column * (width + gap), y + title))
    with atomic(path) as temporary:
        sheet.save(temporary, "PNG")


@lru_cache(maxsize=4)
def _backdrop(width: int, height: int) -> np.ndarray:
    """Linear RGB ``[H,W,3]``: neutral grey, lighter behind the object."""
    y, x = np.mgrid[0:height, 0:width]
    radius = np.hypot((x + 0.5) / width - 0.5, (y + 0.5) / height - 0.45) / 0.75
    weight = np.clip(radius, 0, 1)[..., None] ** 1.5
    return ((1 - weight) * _BACKDROP[0] + weight * _BACKDROP[1]).astype(np.float32)


def _rounded(width: int, height: int, radius: int = 14) -> Image.Image:
    """A mask with round corners, antialiased by drawing it four times too large."""
    mask = Image.new("L", (4 * width, 4 * height), 0)
    ImageDraw.Draw(mask).rounded_rectangle((0, 0, 4 * width - 1, 4 * height - 1), 4 * radius, 255)
    return mask.resize((width, height), Image.Resampling.BOX)


def _font(size: int, bold: bool = False) -> ImageFont.FreeTypeFont:
    """DejaVu Sans from matplotlib: it has the degree sign and most alphabets, and is the same on every machine."""
    import matplotlib

    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    return ImageFont.truetype(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / name, size)


def _shorten(draw: ImageDraw.ImageDraw, text: str, font: ImageFont.FreeTypeFont, width: int) -> str:
    """One line of ``text`` that is at most ``width`` pixels wide."""
    text = " ".join(text.split())
    if draw.textlength(text, font) <= width:
        return text
    while text and draw.textlength(text + "…", font) > width:
        text = text[:-1]
    return text.rstrip() + "…"

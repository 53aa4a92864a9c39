"""Which beads can be seen at all: most of a part's filament lies within it."""

from __future__ import annotations

import manifold3d
import numpy as np
from PIL import Image, ImageDraw

from genmf_mi.printing.paths import Bead
from genmf_mi.printing.slices import Slices

COVER_MM = 1.0
"""What lies farther than this from the outline of its layer and of the two next to it is hidden."""
_PIXEL_MM, _SAMPLE_MM = 0.2, 0.5


def visible(beads: list[Bead], slices: Slices) -> list[Bead]:
    """The outer beads, and those others that come near the surface anywhere; supports are left out.

    slices: of the same part in the same place, at the same layer height.
    """
    if not beads:
        return []
    low = np.min([bead.points.min(axis=0) for bead in beads], axis=0) - 1
    high = np.max([bead.points.max(axis=0) for bead in beads], axis=0) + 1
    size = tuple(int(n) for n in np.ceil((high - low) / _PIXEL_MM))
    hidden: dict[int, np.ndarray] = {}
    seen: list[Bead] = []
    for bead in beads:
        if bead.role == "support":
            continue
        if bead.role != "outer":
            layer = round(bead.top / slices.layer_mm) - 1
            if layer not in hidden:
                hidden[layer] = _raster(_covered(slices, layer), low, size)
            column, row = ((_sampled(bead.points) - low) / _PIXEL_MM).astype(int).T
            if hidden[layer][row, column].all():
                continue
        seen.append(bead)
    return seen


def _covered(slices: Slices, layer: int) -> manifold3d.CrossSection:
    """What lies well within the outlines of a layer and of the two next to it."""
    if not 0 < layer < len(slices.outlines) - 1:
        return manifold3d.CrossSection()
    below, here, above = slices.outlines[layer - 1 : layer + 2]
    return (below ^ here ^ above).offset(-COVER_MM, manifold3d.JoinType.Square)


def _raster(outline: manifold3d.CrossSection, low: np.ndarray, size: tuple[int, ...]) -> np.ndarray:
    """``[H,W]`` whether the middle of a pixel lies within; outlines run anticlockwise around the inside."""
    image = Image.new("1", (size[0], size[1]))
    draw = ImageDraw.Draw(image)
    polygons = [(np.asarray(polygon) - low) / _PIXEL_MM for polygon in outline.to_polygons()]
    areas = [0.5 * np.sum(p[:, 0] * np.roll(p[:, 1], -1) - np.roll(p[:, 0], -1) * p[:, 1]) for p in polygons]
    for fill in (1, 0):  # holes after what they are in
        for polygon, area in zip(polygons, areas):
            if (area > 0) == bool(fill):
                draw.polygon([tuple(point) for point in polygon], fill=fill)
    return np.array(image)


def _sampled(points: np.ndarray) -> np.ndarray:
    """Points ``[N,2]`` on a polyline, no farther than :data:`_SAMPLE_MM` apart."""
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    counts = np.maximum(1, np.ceil(steps / _SAMPLE_MM).astype(int))
    start = np.repeat(np.arange(len(steps)), counts)
    share = (np.arange(len(start)) - np.repeat(np.cumsum(counts) - counts, counts)) / counts[start]
    return np.concatenate([points[start] + share[:, None] * (points[start + 1] - points[start]), points[-1:]])

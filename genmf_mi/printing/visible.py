"""Which beads can be seen at all: most of a part's filament lies within it."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import manifold3d
import numpy as np
from PIL import Image, ImageDraw

from genmf_mi.printing.paths import Bead
from genmf_mi.printing.slices import Slices

COVER = 1.1
"""Line widths from the outline of a layer and of the two next to it, within which all is hidden by the outer beads."""
_PIXEL_MM, _SAMPLE_MM = 0.1, 0.5


def visible(beads: list[Bead], slices: Slices) -> list[Bead]:
    """The outer beads, and the pieces of others that come near the surface; supports are left out.

    slices: of the same part in the same place, at the same layer height.
    """
    if not beads:
        return []
    low = np.min([bead.points.min(axis=0) for bead in beads], axis=0) - 1
    high = np.max([bead.points.max(axis=0) for bead in beads], axis=0) + 1
    size = tuple(int(n) for n in np.ceil((high - low) / _PIXEL_MM))
    cover_mm = COVER * float(np.median(np.concatenate([bead.width for bead in beads])))

    @lru_cache(maxsize=2)  # beads come layer by layer, and all layers of a large part would fill gigabytes
    def hidden(layer: int) -> np.ndarray:
        return _raster(_covered(slices, layer, cover_mm), low, size)

    seen: list[Bead] = []
    for bead in beads:
        if bead.role == "outer":
            seen.append(bead)
        elif bead.role != "support":
            points, step = _sampled(_steps(bead.points, bead.closed))
            column, row = ((points - low) / _PIXEL_MM).astype(int).T
            covered = hidden(round(bead.top / slices.layer_mm) - 1)[row, column]
            seen += _pieces(bead, np.unique(step[~covered]))
    return seen


def _covered(slices: Slices, layer: int, cover_mm: float) -> manifold3d.CrossSection:
    """What lies well within the outlines of a layer and of the two next to it."""
    if not 0 < layer < len(slices.outlines) - 1:
        return manifold3d.CrossSection()
    below, here, above = slices.outlines[layer - 1 : layer + 2]
    return (below ^ here ^ above).offset(-cover_mm, manifold3d.JoinType.Square)


def _pieces(bead: Bead, shown: np.ndarray) -> list[Bead]:
    """What is left of a bead if only some of the steps from point to point are shown, which are given by number."""
    count = len(bead.points) - 1 + bead.closed
    if len(shown) == count:
        return [bead]
    numbers = np.arange(count + 1)
    if bead.closed:  # from a step that is hidden, so that no piece runs across the end
        first = np.setdiff1d(np.arange(count), shown)[0]
        shown, numbers = np.sort((shown - first) % count), (numbers + first) % count
    runs = np.split(shown, np.flatnonzero(np.diff(shown) > 1) + 1) if len(shown) else []
    corners = [numbers[run[0] : run[-1] + 2] for run in runs]
    return [replace(bead, points=bead.points[i], width=bead.width[i], closed=False) for i in corners]


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


def _steps(points: np.ndarray, closed: bool) -> np.ndarray:
    """``[S,2,2]`` from point to point, and back to the first where the path is closed."""
    return np.stack([points, np.roll(points, -1, axis=0)], axis=1)[: None if closed else -1]


def _sampled(steps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points ``[N,2]`` on steps ``[S,2,2]``, ends and no farther than :data:`_SAMPLE_MM` apart, and whose they are."""
    start, way = steps[:, 0], steps[:, 1] - steps[:, 0]
    counts = 1 + np.maximum(1, np.ceil(np.linalg.norm(way, axis=1) / _SAMPLE_MM).astype(int))
    of = np.repeat(np.arange(len(steps)), counts)
    share = (np.arange(len(of)) - np.repeat(np.cumsum(counts) - counts, counts)) / (counts[of] - 1)
    return start[of] + share[:, None] * way[of], of

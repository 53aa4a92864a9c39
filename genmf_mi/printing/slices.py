"""A slicer of our own, for machines that have none: a bead along every contour, level areas within."""

from __future__ import annotations

from dataclasses import dataclass

import manifold3d
import numpy as np

from genmf_mi.core.errors import SolidError
from genmf_mi.core.printer import Printer
from genmf_mi.mesh.manifold import to_manifold
from genmf_mi.printing.paths import Bead
from genmf_mi.printing.sweep import Triangles, sweep

_SEGMENTS = 48
"""Of a full turn where an outline is moved round a corner."""
_TOLERANCE_MM = 0.005
"""Outlines are simplified by at most this."""


@dataclass(frozen=True)
class Slices:
    """Outlines of a part at the middle of every layer.

    outlines: as `manifold3d` holds them, from below to above. layer_mm: their distance.
    """

    outlines: list[manifold3d.CrossSection]
    layer_mm: float

    @classmethod
    def of(cls, vertices: np.ndarray, faces: np.ndarray, layer_mm: float) -> Slices:
        """Of a part ``[V,3]``, ``[F,3]`` in mm, z up, on z = 0. Raises :class:`SolidError` if it is not closed."""
        body = to_manifold(vertices, faces)
        if body.is_empty() or body.status() != manifold3d.Error.NoError:
            raise SolidError("the part is no closed solid, so it cannot be sliced. Refine it, or repair it first.")
        count = max(1, round(float(vertices[:, 2].max()) / layer_mm))
        return cls([body.slice((i + 0.5) * layer_mm) for i in range(count)], layer_mm)

    @property
    def area_mm2(self) -> float:
        """Of all outlines together."""
        return float(sum(outline.area() for outline in self.outlines))

    def too_thin_mm2(self, width_mm: float) -> float:
        """The area of all outlines that a line of this width does not fit into."""
        kept = (_moved(_moved(outline, -width_mm / 2), width_mm / 2) for outline in self.outlines)
        return self.area_mm2 - float(sum(outline.area() for outline in kept))

    def printed(self, printer: Printer, segments: int = 4) -> Triangles:
        """What the printer makes of the outlines, to look at."""
        beads: list[Bead] = []
        levels: list[Triangles] = []
        for i, outline in enumerate(self.outlines):
            middle = _moved(outline, -printer.line_width_mm / 2).simplify(_TOLERANCE_MM)
            if middle.is_empty():
                continue
            polygons = [np.asarray(polygon, dtype=np.float64) for polygon in middle.to_polygons()]
            top = (i + 1) * self.layer_mm
            for polygon in polygons:
                width = np.full(len(polygon), printer.line_width_mm)
                beads.append(Bead(polygon, width, top, self.layer_mm, "outer", closed=True))
            levels += [_level(polygons, top, 1), _level(polygons, top - self.layer_mm, -1)]
        return Triangles.joined([sweep(beads, printer.bulge, segments), *levels])


def _moved(outline: manifold3d.CrossSection, distance: float) -> manifold3d.CrossSection:
    return outline.offset(distance, manifold3d.JoinType.Round, 2.0, _SEGMENTS)


def _level(polygons: list[np.ndarray], height: float, up: int) -> Triangles:
    """The area within polygons at one height, seen from above (``up`` 1) or from below (-1)."""
    points = np.concatenate(polygons)
    faces = np.asarray(manifold3d.triangulate(polygons), dtype=np.int64).reshape(-1, 3)
    vertices = np.column_stack([points, np.full(len(points), height)])
    return Triangles(vertices, np.tile([0.0, 0.0, float(up)], (len(points), 1)), faces[:, ::up])

"""A slicer of our own: outlines, what does not fit, and the part as it looks."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from genmf_mi.core.errors import SolidError
from genmf_mi.core.printer import PRINTERS
from genmf_mi.printing.paths import Bead
from genmf_mi.printing.slices import Slices
from genmf_mi.printing.visible import COVER, visible

PRINTER = PRINTERS["fdm-0.2"]


def on_bed(mesh: trimesh.Trimesh) -> tuple[np.ndarray, np.ndarray]:
    return np.array(mesh.vertices - [0, 0, mesh.bounds[0, 2]]), np.array(mesh.faces)


class TestSlices:
    def test_cone(self):
        """Areas of the outlines are those of the circles half-way up each layer."""
        slices = Slices.of(*on_bed(trimesh.creation.cone(10, 8, sections=256)), 0.2)
        middle = (np.arange(40) + 0.5) * 0.2
        expected = np.pi * (10 * (1 - middle / 8)) ** 2
        found = [outline.area() for outline in slices.outlines]
        np.testing.assert_allclose(found, expected, rtol=1e-3)
        assert slices.area_mm2 == pytest.approx(sum(expected), rel=1e-3)

    def test_too_thin(self):
        """A fin of a quarter of a millimetre is lost, but for nothing else."""
        box, fin = trimesh.creation.box((10, 10, 2)), trimesh.creation.box((5, 0.25, 2))
        fin.apply_translation([7.4, 0, 0])
        slices = Slices.of(*on_bed(trimesh.boolean.union([box, fin])), 0.2)
        # Round corners of the box are what a round nozzle leaves of square ones
        corners = (4 - np.pi) * 0.2**2
        assert slices.too_thin_mm2(0.4) == pytest.approx(10 * (4.9 * 0.25 + corners), rel=0.05)

    def test_open_mesh(self):
        with pytest.raises(SolidError, match="closed"):
            Slices.of(*on_bed(trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 1]], [[0, 1, 2]])), 0.2)

    def test_printed(self):
        """Beads keep the outline: their widest place touches it, and treads are level."""
        printed = Slices.of(*on_bed(trimesh.creation.cylinder(10, 4, sections=256)), 0.2).printed(PRINTER)
        radius = np.linalg.norm(printed.vertices[:, :2], axis=1)
        assert radius.max() == pytest.approx(10, abs=0.01)
        assert (printed.vertices[:, 2].min(), printed.vertices[:, 2].max()) == pytest.approx((0, 4))
        level = np.abs(printed.normals[:, 2]) == 1
        assert radius[level].max() < 10 - 0.2 * PRINTER.bulge + 0.01


class TestVisible:
    slices = Slices.of(*on_bed(trimesh.creation.box((20, 20, 4))), 0.2)

    @staticmethod
    def bead(points, layer: int, role="fill", closed=False) -> Bead:
        points = np.array(points, dtype=float)
        return Bead(points, np.full(len(points), 0.45), (layer + 1) * 0.2, 0.2, role, closed)

    def test_only_what_is_near_the_surface(self):
        def line(y: float, layer: int, role="fill") -> Bead:
            return self.bead([[-6, y], [6, y]], layer, role)

        inside, near_side = line(0, 10), line(10 - COVER * 0.45 / 2, 10)
        top, bottom, outline, support = line(0, 19), line(0, 0), line(0, 10, "outer"), line(0, 0, "support")
        shown = visible([inside, near_side, top, bottom, outline, support], self.slices)
        assert shown == [near_side, top, bottom, outline]
        assert visible([], self.slices) == []

    @pytest.mark.parametrize("start", range(6))
    def test_pieces_of_a_loop(self, start):
        """Two of its corners come near the side: what leads there is kept, wherever the loop begins."""
        loop = np.roll([[0, 0], [5, 0], [9.8, 0], [9.8, 5], [5, 5], [0, 5]], start, axis=0)
        (shown,) = visible([self.bead(loop, 10, "inner", closed=True)], self.slices)
        assert shown.points.tolist() == [[5, 0], [9.8, 0], [9.8, 5], [5, 5]] and not shown.closed
        (whole,) = visible([self.bead(loop, 19, "inner", closed=True)], self.slices)
        assert whole.closed and whole.points.tolist() == loop.tolist()

    def test_pieces_of_a_line(self):
        """What leads inwards from either side, and nothing between."""
        line = self.bead([[-9.8, 0], [-4, 0], [0, 0], [4, 0], [9.8, 0]], 10)
        left, right = visible([line], self.slices)
        assert left.points.tolist() == [[-9.8, 0], [-4, 0]] and right.points.tolist() == [[4, 0], [9.8, 0]]
        assert len(left.width) == len(right.width) == 2

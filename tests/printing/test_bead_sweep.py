"""Beads as triangles, against what a rounded line has in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from genmf_mi.printing.paths import Bead
from genmf_mi.printing.sweep import Triangles, sweep


def bead(points, *, width=0.45, top=0.4, height=0.2, closed=False) -> Bead:
    points = np.asarray(points, dtype=float)
    return Bead(points, np.full(len(points), width), top, height, "outer", closed)


def circle(radius: float, count: int = 400) -> np.ndarray:
    angle = np.arange(count) / count * 2 * np.pi
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def face_normals(mesh: Triangles) -> np.ndarray:
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    return np.cross(b - a, c - a)


class TestSweep:
    def test_size(self):
        """A line with round ends is as long as it is, plus its width."""
        mesh = sweep([bead([[0, 0], [5, 0]])])
        np.testing.assert_allclose(mesh.vertices.min(axis=0), [-0.225, -0.225, 0.2], atol=1e-9)
        np.testing.assert_allclose(mesh.vertices.max(axis=0), [5.225, 0.225, 0.4], atol=1e-9)

    def test_normals_point_outward_as_the_faces_do(self):
        for closed in (False, True):
            mesh = sweep([bead(circle(10), closed=closed)])
            assert np.allclose(np.linalg.norm(mesh.normals, axis=1), 1)
            flat = face_normals(mesh)
            real = np.linalg.norm(flat, axis=1) > 1e-9
            smooth = mesh.normals[mesh.faces].mean(axis=1)
            outward = np.einsum("fk,fk->f", flat, smooth)[real] > 0
            assert outward.mean() > (0.999 if closed else 0.97)  # round ends turn about their own inside

    def test_ring(self):
        """Closed, and of the volume that Pappus gives: the area of the cross-section times the way of its middle."""
        mesh = sweep([bead(circle(10), closed=True)], segments=32)
        a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
        volume = np.einsum("fk,fk->f", a, np.cross(b, c)).sum() / 6
        assert volume == pytest.approx((0.25 * 0.2 + np.pi * 0.01) * 2 * np.pi * 10, rel=2e-3)
        edges = np.sort(mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()

    def test_round_side(self):
        """The side of a straight bead is half a circle of its height, or half an ellipse."""
        for bulge in (0.5, 0.25):
            mesh = sweep([bead([[0, 0], [5, 0]])], bulge=bulge, segments=8)
            middle = (np.abs(mesh.vertices[:, 0] - 5) < 1e-9) & (np.abs(mesh.normals[:, 0]) < 1e-9)
            y, z = np.abs(mesh.vertices[middle, 1]) - (0.225 - bulge * 0.2), mesh.vertices[middle, 2] - 0.3
            np.testing.assert_allclose((y / (bulge * 0.2)) ** 2 + (z / 0.1) ** 2, 1, atol=1e-9)

    def test_corner_is_rounded_outside_and_keeps_its_width(self):
        mesh = sweep([bead([[0, 0], [5, 0], [5, 5]])])
        corner = np.linalg.norm(mesh.vertices[:, :2] - [5, 0], axis=1)
        outside = (mesh.vertices[:, 0] > 5) & (mesh.vertices[:, 1] < 0)
        assert corner[outside].max() == pytest.approx(0.225)

    def test_many_are_each_alone(self):
        """A layer of beads at once is the beads one by one."""
        some = [bead(circle(3, 20), closed=True), bead([[0, 0], [1, 0], [1, 4]], top=1.0), bead([[9, 9], [8, 7]])]
        together, alone = sweep(some), Triangles.joined([sweep([one]) for one in some])
        np.testing.assert_allclose(together.vertices, alone.vertices)
        assert sorted(map(tuple, together.faces)) == sorted(map(tuple, alone.faces))

    def test_repeated_points_and_dots(self):
        twice = sweep([bead([[0, 0], [0, 0], [5, 0], [5, 0]])])
        np.testing.assert_allclose(twice.vertices, sweep([bead([[0, 0], [5, 0]])]).vertices)
        assert len(sweep([bead([[1, 1], [1, 1]])]).faces) == 0 == len(sweep([]).faces)

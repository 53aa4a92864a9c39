"""Shapes whose faults as a print are known."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from genmf_mi.core.printer import PRINTERS
from genmf_mi.printing.printability import curvature, floating_parts, printability
from genmf_mi.printing.slices import Slices

PRINTER = PRINTERS["fdm-0.2"]


def report(mesh: trimesh.Trimesh) -> dict:
    vertices = mesh.vertices - [0, 0, mesh.bounds[0, 2]]
    return printability(np.array(vertices), np.array(mesh.faces), Slices.of(vertices, mesh.faces, 0.2), PRINTER)


class TestPrintability:
    def test_a_block_is_ready(self):
        found = report(trimesh.creation.box((20, 20, 10)))
        assert found["verdict"] == "ready" and found["reasons"] == []
        assert found["first_layer_mm2"] == pytest.approx(400)
        assert found["overhang_mm2"] == found["floating_parts"] == 0

    def test_a_table_hangs_over(self):
        top, leg = trimesh.creation.box((40, 40, 4)), trimesh.creation.box((12, 12, 20))
        top.apply_translation([0, 0, 12])
        found = report(trimesh.boolean.union([top, leg]))
        assert found["overhang_mm2"] == pytest.approx(40 * 40 - 12 * 12, rel=1e-6)
        assert found["verdict"] == "look at" and "hangs over" in found["reasons"][0]

    def test_a_hook_starts_in_the_air(self):
        """A beam on a post, from whose end a peg hangs down without reaching the bed."""
        post, beam, peg = (trimesh.creation.box(size) for size in ((12, 12, 30), (40, 12, 6), (6, 12, 14)))
        post.apply_translation([0, 0, 15])
        beam.apply_translation([14, 0, 27])
        peg.apply_translation([31, 0, 20])
        hook = trimesh.boolean.union([post, beam, peg])
        found = report(hook)
        assert found["floating_parts"] == 1 and "1 piece of a layer starts in the air" in " ".join(found["reasons"])
        assert floating_parts(Slices.of(hook.vertices, hook.faces, 0.2)) == 1

    def test_a_ball_wants_a_brim(self):
        found = report(trimesh.creation.icosphere(5, radius=10))
        assert "brim" in found["reasons"][0] and found["first_layer_mm2"] < 10

    def test_a_wall_of_less_than_two_lines(self):
        base, wall = trimesh.creation.box((30, 30, 4)), trimesh.creation.box((30, 0.7, 30))
        base.apply_translation([0, 0, 2])
        wall.apply_translation([0, 0, 18])
        found = report(trimesh.boolean.union([base, wall]).subdivide().subdivide().subdivide())
        assert found["min_thickness_mm"] == pytest.approx(0.7, abs=0.01)
        assert len(found["reasons"]) == 1 and "0.7 mm, and two lines need 0.9 mm" in found["reasons"][0]

    def test_a_sheet_is_not_printable(self):
        found = report(trimesh.creation.box((30, 0.2, 30)))
        assert found["verdict"] == "not printable"
        assert any("thinner than the nozzle" in reason for reason in found["reasons"])


def test_curvature_of_a_ball():
    """1/r everywhere."""
    ball = trimesh.creation.icosphere(5, radius=8)
    for value in curvature(np.array(ball.vertices), np.array(ball.faces)).values():
        assert value == pytest.approx(1 / 8, rel=0.03)

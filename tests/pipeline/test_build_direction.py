"""Which way up a part is printed: candidates, what they cost, and whole runs that do not stand upright."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from toy_runs import CONFIG
from toys import stripes

import genmf_mi
from genmf_mi.assets.asset import Asset
from genmf_mi.core.frame import DIRECTIONS, UPRIGHT
from genmf_mi.core.printer import PRINTERS
from genmf_mi.geometry.displacement_bounds import base
from genmf_mi.pipeline.poses import candidates, pose
from genmf_mi.pipeline.print_check import print_check
from genmf_mi.report import tables
from genmf_mi.report.remarks import remarks

FILAMENT = replace(CONFIG, printer="fdm-0.2", size_mm=30.0, edge_mm=1.0)


@pytest.fixture(scope="module")
def slab() -> Asset:
    """A plate on its edge: 30 mm wide and high, 6 mm thick."""
    box = trimesh.creation.box((1, 1, 0.2)).subdivide().subdivide().subdivide()
    return Asset.from_arrays("slab", np.array(box.vertices), np.array(box.faces), colours=stripes(box.vertices))


def box_surface(extents: tuple[float, float, float], turned: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    box = trimesh.creation.box(extents)
    for _ in range(3):
        box = box.subdivide()
    box.apply_transform(trimesh.transformations.rotation_matrix(turned, (1, 0.3, 0.2)))
    return np.array(box.vertices), np.array(box.faces)


class TestAuto:
    def test_what_stands_stays(self):
        found = pose("auto", *box_surface((1, 1, 0.2)))
        assert (found.name, found.up, found.unsteady) == ("upright", UPRIGHT, False)

    def test_lies_on_its_largest_side_exactly(self):
        """A plate that leans: neither the name of an axis nor the coarse hull says how."""
        vertices, faces = box_surface((1, 1, 0.2), turned=0.5)
        assert pose("upright", vertices, faces).unsteady
        found = pose("auto", vertices, faces)
        side = trimesh.transformations.rotation_matrix(0.5, (1, 0.3, 0.2))[:3, 2]
        assert abs(np.dot(found.up, side)) == pytest.approx(1, abs=1e-9)
        assert found.name == "tilted" and not found.unsteady
        assert len(base(vertices, faces, found.up)) == 81

    def test_square_to_an_axis_where_it_almost_is(self):
        turn = np.radians(90.2)
        found = pose("auto", *box_surface((1, 0.2, 1), turned=0.0))
        assert found.name == "upright"
        cone = trimesh.creation.cone(1, 3, sections=64).subdivide().subdivide()
        cone.apply_transform(trimesh.transformations.rotation_matrix(turn, (1, 0, 0)))
        found = pose("auto", np.array(cone.vertices), np.array(cone.faces))
        assert found.name == "upside-down" and found.up == DIRECTIONS["upside-down"]

    def test_without_a_flat_side_it_stays_upright(self):
        ball = trimesh.creation.icosphere(4)
        found = pose("auto", np.array(ball.vertices), np.array(ball.faces))
        assert (found.name, found.up, found.unsteady) == ("upright", UPRIGHT, True)


def test_candidates_start_upright_and_are_the_sides_of_a_box():
    box = trimesh.creation.box((3, 2, 4)).subdivide().subdivide()
    found = dict(candidates(np.array(box.vertices)))
    assert next(iter(found)) == "upright"
    assert set(found) == set(DIRECTIONS)
    assert all(found[name] == DIRECTIONS[name] for name in found)


def test_a_cone_may_lie_on_its_side():
    cone = trimesh.creation.cone(1.0, 3.0, sections=64)
    found = candidates(np.array(cone.vertices)[:, [0, 2, 1]] * (1, 1, -1))
    assert "tilted" in [name for name, _ in found]
    for _, up in found:
        assert np.linalg.norm(up) == pytest.approx(1)


class TestRefine:
    def test_lies_on_the_side_that_it_is_told(self, slab, small_refinements, two_views, tmp_path):
        """The print files lie, the model stays as it was, and what touches the bed stays flat."""
        config = replace(FILAMENT, stand="on-back", iterations=3)
        result = genmf_mi.refine(slab, config, scene=two_views, out=tmp_path / "run")
        width, depth, height = np.ptp(result.vertices_mm, axis=0)
        assert height == pytest.approx(6, abs=0.7) and min(width, depth) > 29
        assert np.ptp(result.vertices, axis=0).argmin() == 2
        printed = trimesh.load_mesh(tmp_path / "run" / "refined.3mf")
        assert printed.extents[2] == pytest.approx(height, abs=1e-3)
        on_bed = result.vertices_mm[:, 2] < 1e-3
        assert on_bed.sum() > 100 and np.abs(result.relief_mm[on_bed]).max() < 1e-6
        assert result.metrics["stand"] == {"name": "on-back", "up": [0.0, 0.0, 1.0]}

    def test_auto_lays_down_what_does_not_stand_and_says_so(self, slab, small_refinements, two_views, tmp_path):
        turn = trimesh.transformations.rotation_matrix(0.5, (1, 0, 0))[:3, :3]
        leaning = replace(slab, vertices=slab.vertices @ turn.T)
        config = replace(FILAMENT, stand="auto", iterations=3, size_mm=30.0)
        result = genmf_mi.refine(leaning, config, scene=two_views, out=tmp_path / "run")
        stand = result.metrics["stand"]
        assert stand["name"] == "tilted" and stand["asked"] == "auto" and "unsteady" not in stand
        assert np.ptp(result.vertices_mm[:, 2]) < 8
        on_bed = result.vertices_mm[:, 2] < 1e-2
        assert on_bed.sum() > 100 and np.abs(result.relief_mm[on_bed]).max() < 1e-6
        (remark,) = remarks(result.metrics)
        assert "on a slanted flat side" in remark
        assert "on a slanted flat side" in (tmp_path / "run" / "report.html").read_text(encoding="utf-8")

    def test_best_of_all_with_a_table(self, slab, small_refinements, two_views, tmp_path):
        """Its printed self is found again in the folder of the run."""
        out = tmp_path / "run"
        result = genmf_mi.refine(slab, replace(FILAMENT, stand="best", iterations=3), scene=two_views, out=out)
        stand = result.metrics["stand"]
        found = stand["candidates"]
        assert [each["cost"] for each in found] == sorted(each["cost"] for each in found)
        assert {"upright", "on-back", "on-front"} <= {each["name"] for each in found}
        assert stand["name"] == found[0]["name"] and stand["up"] == list(found[0]["up"])
        height = np.ptp(result.vertices_mm[:, 2])
        assert height == pytest.approx(found[0]["height_mm"], abs=2.1)
        assert "Which way up to print it" in (out / "report.html").read_text(encoding="utf-8")
        table = tables.stands(result.metrics)
        assert table is not None and len(table.rows) == len(found)
        layers = print_check(out, slicer="own", scene=two_views).metrics["parts"]["part"]["layers"]
        assert layers == pytest.approx(height / PRINTERS["fdm-0.2"].layer_mm, abs=1)

    def test_the_network_knows_upright_parts_only(self, slab, small_refinements, two_views, waves):
        config = replace(FILAMENT, stand="on-back", stress=True, stress_by="network", iterations=3)
        assert "upright only" in genmf_mi.refine(slab, config, scene=two_views).metrics["stress_stage_left_out"]

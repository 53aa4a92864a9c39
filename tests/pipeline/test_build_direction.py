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
from genmf_mi.core.printer import PRINTERS
from genmf_mi.pipeline.poses import DIRECTIONS, candidates
from genmf_mi.pipeline.print_check import print_check
from genmf_mi.report import tables

FILAMENT = replace(CONFIG, printer="fdm-0.2", size_mm=30.0, edge_mm=1.0)


@pytest.fixture(scope="module")
def slab() -> Asset:
    """A plate on its edge: 30 mm wide and high, 6 mm thick."""
    box = trimesh.creation.box((1, 1, 0.2)).subdivide().subdivide().subdivide()
    return Asset.from_arrays("slab", np.array(box.vertices), np.array(box.faces), colours=stripes(box.vertices))


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

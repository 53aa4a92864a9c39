"""Fine meshes: even, closed, on the surface, creases kept, and the same every time."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from genmf_mi.assets import asset
from genmf_mi.core.errors import SolidError
from genmf_mi.mesh import measures, meshlab, remesh, solid, topology
from genmf_mi.mesh.self_intersections import self_intersections
from genmf_mi.mesh.solid import Solid


def solid_of(mesh: trimesh.Trimesh) -> Solid:
    return Solid(np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int64), {"bodies": 1})


def edges(made: Solid) -> np.ndarray:
    ends = topology.halfedges(made.faces)
    return np.linalg.norm(made.vertices[ends[:, 0]] - made.vertices[ends[:, 1]], axis=1)


def smallest_angles(made: Solid) -> np.ndarray:
    return np.degrees(trimesh.Trimesh(made.vertices, made.faces, process=False).face_angles.min(axis=1))


SHAPES = {
    "box": trimesh.creation.box(extents=[1, 0.6, 0.4]),
    "cylinder": trimesh.creation.cylinder(radius=0.3, height=1, sections=64),
    "torus": trimesh.creation.torus(0.5, 0.2, major_sections=12, minor_sections=8),
    "ball": trimesh.creation.icosphere(subdivisions=5, radius=0.5),
}


@pytest.mark.parametrize("name", SHAPES)
def test_triangles_are_even_and_lie_on_the_surface(name):
    shape = SHAPES[name]
    made = solid.remesh(solid_of(shape), 0.02)
    report = made.report["remesh"]
    assert report["method"] == "isotropic"
    assert trimesh.Trimesh(made.vertices, made.faces, process=True).is_watertight
    assert made.report["bodies"] == 1  # the report of the solid is kept
    low, middle, high = np.percentile(edges(made), [1, 50, 99])
    assert low > 0.009
    assert middle == pytest.approx(0.02, rel=0.2)
    assert high < 0.035
    assert smallest_angles(made).min() > 5
    assert np.percentile(smallest_angles(made), 1) > 20
    assert report["max_deviation"] < 0.005
    exact = trimesh.proximity.closest_point_naive(shape, made.vertices[:: len(made.vertices) // 50])[1]
    assert exact.max() <= report["max_deviation"] + 1e-9
    assert made.report["remesh"]["self_intersections"] == 0


def test_the_edges_of_a_box_stay_sharp():
    made = solid.remesh(solid_of(SHAPES["box"]), 0.02)
    assert measures.signed_volume(made.vertices, made.faces) == pytest.approx(0.24, rel=1e-4)
    corners = np.array(np.meshgrid([-0.5, 0.5], [-0.3, 0.3], [-0.2, 0.2])).reshape(3, -1).T
    gap = np.linalg.norm(made.vertices[:, None] - corners, axis=2).min(axis=0)
    np.testing.assert_allclose(gap, 0, atol=1e-6)


def test_two_runs_agree_exactly():
    first, second = (solid.remesh(solid_of(SHAPES["torus"]), 0.03) for _ in range(2))
    np.testing.assert_array_equal(first.vertices, second.vertices)
    np.testing.assert_array_equal(first.faces, second.faces)


def test_the_budget_of_faces_holds():
    made = solid.remesh(solid_of(SHAPES["ball"]), 0.005, max_faces=9000)
    assert 7000 < len(made.faces) <= 9000
    assert made.report["remesh"]["edge_length"] > made.report["remesh"]["edge_length_wanted"] == 0.005


def test_broken_remeshing_falls_back_to_dividing(monkeypatch):
    def torn(vertices, faces, edge_length, **options):
        return vertices, faces[1:]

    monkeypatch.setattr(meshlab, "isotropic_remeshing", torn)
    made = solid.remesh(solid_of(SHAPES["box"]), 0.05)
    assert made.report["remesh"]["method"] == "divided"
    assert made.report["remesh"]["max_deviation"] < 1e-12
    assert topology.is_closed(made.faces)
    assert edges(made).max() < 2 * 0.05  # the edges of the input are divided exactly, those across may be longer


def test_what_cannot_be_meshed_within_the_budget_is_refused(monkeypatch):
    dense = trimesh.creation.icosphere(subdivisions=5)
    monkeypatch.setattr(remesh, "_isotropic", remesh._divided)
    with pytest.raises(SolidError, match="cannot be meshed with 1000 triangles"):
        solid.remesh(solid_of(dense), 0.5, max_faces=1000)


@pytest.mark.parametrize("name", ["hunyuan_bus", "trellis_volcano", "instantmesh_chair", "teacup"])
def test_real_assets_gain_no_self_intersections(assets, name):
    loaded = asset.load(assets / f"{name}.glb")
    body = solid.solidify(name, loaded.vertices, loaded.faces)
    made = solid.remesh(body, 0.01)
    assert made.report["remesh"]["method"] == "isotropic"
    assert made.report["remesh"]["self_intersections"] <= body.report["self_intersections_asset"]
    assert made.report["remesh"]["max_deviation"] < 0.01
    assert smallest_angles(made).min() > 3
    assert trimesh.Trimesh(made.vertices, made.faces, process=True).is_watertight


def test_finer_triangles_along_an_old_cut_are_not_new():
    both = trimesh.util.concatenate([SHAPES["box"], SHAPES["box"].copy().apply_translation([0.31, 0.17, 0.11])])
    before = len(self_intersections(both.vertices, both.faces))
    made = solid.remesh(solid_of(both), 0.03)
    report = made.report["remesh"]
    assert report["method"] == "isotropic"
    assert report["self_intersections"] > before > 0
    assert report["new_self_intersections"] == 0


@pytest.mark.parametrize(("budget", "method"), [(200_000, "divided"), (2_000, "isotropic")])
def test_a_lost_detail_is_kept_by_dividing_where_the_budget_allows(monkeypatch, budget, method):
    ball = trimesh.creation.icosphere(subdivisions=4)
    spike = np.asarray(ball.vertices).copy()
    spike[0] *= 1.5
    coarse = trimesh.creation.icosphere(subdivisions=3)
    monkeypatch.setattr(remesh, "_isotropic", lambda *_: (np.asarray(coarse.vertices), np.asarray(coarse.faces)))
    made = solid.remesh(Solid(spike, np.asarray(ball.faces)), 0.05, max_faces=budget)
    assert made.report["remesh"]["method"] == method
    assert (made.report["remesh"]["max_deviation"] > 0.4) == (method == "isotropic")

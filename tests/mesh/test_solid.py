"""From broken meshes to solids: what is mended, what is rebuilt, what is refused; trimesh has the last word."""

from __future__ import annotations

import time
from functools import partial

import numpy as np
import pytest
import trimesh

from genmf_mi.assets import asset
from genmf_mi.core.errors import SolidError
from genmf_mi.mesh import measures, rebuild, repair, solid, topology
from genmf_mi.mesh.manifold import is_solid
from genmf_mi.mesh.nearest import distance_to_surface

BALL = trimesh.creation.icosphere(subdivisions=3)
BOX = trimesh.creation.box()


@pytest.fixture(autouse=True)
def coarse_rebuilding(monkeypatch):
    """64 cells instead of 256: seconds instead of minutes."""
    monkeypatch.setattr(rebuild, "rebuild", partial(rebuild.rebuild, cells=64))


def solidify(vertices, faces) -> solid.Solid:
    """The solid of a mesh, after trimesh has confirmed that it is one, also when welded by position as from an STL."""
    made = solid.solidify("thing", np.asarray(vertices, float), np.asarray(faces))
    judged = trimesh.Trimesh(made.vertices, made.faces, process=True)
    assert judged.is_watertight
    assert judged.is_winding_consistent
    assert judged.volume == pytest.approx(made.report["volume"])
    assert judged.body_count == made.report["bodies"]
    return made


def joined(*parts: trimesh.Trimesh) -> trimesh.Trimesh:
    return trimesh.util.concatenate(list(parts))


def moved(part: trimesh.Trimesh, *offset: float) -> trimesh.Trimesh:
    return part.copy().apply_translation(offset)


def test_a_good_mesh_passes_untouched():
    made = solidify(BALL.vertices, BALL.faces)
    np.testing.assert_allclose(made.vertices[made.faces], BALL.triangles)
    assert not made.report["rebuilt"]
    assert made.report["faces_turned"] == made.report["holes_capped"] == 0
    assert made.report["volume_before"] == pytest.approx(made.report["volume"])


def test_seams_are_welded():
    soup = BALL.triangles.reshape(-1, 3)
    made = solidify(soup, np.arange(len(soup)).reshape(-1, 3))
    assert len(made.vertices) == len(BALL.vertices)
    assert made.report["vertices_before"] == len(soup)


def test_inside_out_and_mixed_faces_are_turned():
    assert solidify(BALL.vertices, BALL.faces[:, ::-1]).report["faces_turned"] == len(BALL.faces)
    flipped = np.random.default_rng(0).random(len(BALL.faces)) < 0.3
    faces = np.where(flipped[:, None], BALL.faces[:, ::-1], BALL.faces)
    made = solidify(BALL.vertices, faces)
    assert made.report["faces_turned"] == flipped.sum()
    assert made.report["volume"] == pytest.approx(BALL.volume)


def test_double_and_collapsed_faces_are_dropped():
    faces = np.vstack([BALL.faces, BALL.faces[:9], [[0, 0, 1]]])
    assert len(solidify(BALL.vertices, faces).faces) == len(BALL.faces)
    twice = np.vstack([BALL.faces, BALL.faces[:, ::-1]])
    assert len(solidify(BALL.vertices, twice).faces) == len(BALL.faces)


def test_many_small_holes_are_capped():
    kept = np.random.default_rng(0).random(len(BALL.faces)) > 0.04
    made = solidify(BALL.vertices, BALL.faces[kept])
    assert made.report["holes_capped"] > 20
    assert not made.report["rebuilt"]
    assert made.report["volume"] == pytest.approx(BALL.volume, rel=2e-3)


def test_the_open_base_of_a_bust_is_capped_flat():
    bust = BALL.faces[BALL.triangles_center[:, 1] > -0.7]
    made = solidify(BALL.vertices, bust)
    assert made.report["holes_capped"] == 1
    rim = topology.boundary_loops(bust)[0]
    assert np.ptp(BALL.vertices[rim, 1]) < 0.15
    assert made.report["volume"] == pytest.approx(BALL.volume * 0.94, rel=0.02)


def test_overlapping_bodies_are_united():
    made = solidify(*_arrays(joined(BOX, moved(BOX, 0.5, 0.5, 0.5))))
    assert made.report["bodies_before"] == 2
    assert made.report["bodies"] == 1
    assert made.report["volume"] == pytest.approx(2 - 0.125)


def test_an_open_part_set_into_another_body_is_kept():
    eye = trimesh.creation.icosphere(subdivisions=2, radius=0.3)
    eye = moved(trimesh.Trimesh(eye.vertices, eye.faces[eye.triangles_center[:, 1] > -0.05]), 0, 0.85, 0)
    made = solidify(*_arrays(joined(BALL, eye)))
    assert made.report["self_intersections_asset"] > 0
    assert made.report["holes_capped"] == 1
    assert made.report["bodies"] == 1
    assert made.vertices[:, 1].max() == pytest.approx(1.15, abs=0.01)


def test_cavities_are_filled_and_strays_left_out():
    hollow = joined(BOX, trimesh.creation.box(extents=[0.5] * 3))
    assert solidify(*_arrays(hollow)).report["volume"] == pytest.approx(1)
    crumb = moved(trimesh.creation.icosphere(subdivisions=1, radius=0.05), 2, 0, 0)
    made = solidify(*_arrays(joined(BALL, crumb)))
    assert made.report["stray_bodies_dropped"] == 1
    assert made.report["bodies"] == 1


def test_a_room_of_walls_becomes_one_block():
    # Six slabs around an empty room: their union has a cavity that no filament could leave.
    slabs = []
    for axis in range(3):
        extents = np.ones(3)
        extents[axis] = 0.2
        slabs += [moved(trimesh.creation.box(extents=extents), *(sign * 0.4 * np.eye(3)[axis])) for sign in (-1, 1)]
    made = solidify(*_arrays(joined(*slabs)))
    assert made.report["cavities_filled"] == 1
    assert made.report["volume"] == pytest.approx(1)


def test_two_large_bodies_stay_two():
    assert solidify(*_arrays(joined(BALL, moved(BALL, 3, 0, 0)))).report["bodies"] == 2


@pytest.mark.parametrize("merge", [False, True])
def test_walls_between_bodies_go(merge):
    both = joined(BOX, moved(BOX, 1, 0, 0))
    both.merge_vertices()
    faces = both.faces if not merge else topology.without_duplicates(both.faces)
    made = solidify(both.vertices, faces)
    assert made.report["volume"] == pytest.approx(2)
    assert made.report["bodies"] == 1


def test_bodies_that_touch_along_an_edge_are_separated():
    made = solidify(*_arrays(joined(BOX, moved(BOX, 1, 1, 0))))
    assert made.report["touching_vertices_separated"] > 0
    assert made.report["volume"] == pytest.approx(2, rel=1e-3)


def test_soup_with_gaps_is_rebuilt_where_it_was():
    rng = np.random.default_rng(0)
    coarse = trimesh.creation.icosphere(subdivisions=2)
    soup = coarse.triangles.reshape(-1, 3) + rng.normal(size=(960, 3)) * 3e-3
    made = solidify(soup, np.arange(960).reshape(-1, 3))
    assert made.report["rebuilt"]
    assert made.report["bodies"] == 1
    assert made.report["volume"] == pytest.approx(coarse.volume, rel=0.02)
    assert distance_to_surface(made.vertices, coarse.vertices, coarse.faces).max() < 0.05


def sheet(resolution: int = 30) -> tuple[np.ndarray, np.ndarray]:
    x, z = np.meshgrid(np.linspace(-1, 1, resolution), np.linspace(-1, 1, resolution), indexing="ij")
    vertices = np.stack([x, 0.2 * np.sin(3 * x) * np.cos(2 * z), z], axis=-1).reshape(-1, 3)
    grid = np.arange(resolution**2).reshape(resolution, resolution)
    a, b, c, d = grid[:-1, :-1].ravel(), grid[1:, :-1].ravel(), grid[1:, 1:].ravel(), grid[:-1, 1:].ravel()
    return vertices, np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])


def _arrays(mesh: trimesh.Trimesh) -> tuple[np.ndarray, np.ndarray]:
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)


def refused_sheets() -> dict[str, tuple[np.ndarray, np.ndarray]]:
    vertices, faces = sheet()
    flat = np.array([[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]], dtype=np.float64)
    return {
        "plane": (flat, np.array([[0, 1, 2], [0, 2, 3]])),
        "leaf": (vertices, faces),
        "double-sided leaf": (vertices, np.vstack([faces, faces[:, ::-1]])),
        "two-sheet leaf": (np.vstack([vertices, vertices]), np.vstack([faces, faces[:, ::-1] + len(vertices)])),
        "foil": _arrays(trimesh.creation.box(extents=[1, 1e-5, 1])),
        "ball with a card": _arrays(joined(BALL, trimesh.Trimesh(vertices + [2, 0, 0], faces))),  # noqa: RUF005
    }


@pytest.mark.parametrize("name", refused_sheets())
def test_sheets_are_refused_by_name(name):
    with pytest.raises(SolidError, match=f"{name} is, or has parts that are, a sheet without thickness"):
        solid.solidify(name, *refused_sheets()[name])


def test_a_bowl_is_refused_because_too_much_of_it_is_missing():
    bowl = BALL.faces[BALL.triangles_center[:, 1] < 0]
    with pytest.raises(SolidError, match=r"bowl is open: \d\d% of its surface is missing"):
        solid.solidify("bowl", BALL.vertices, bowl)


def test_collapsed_faces_only():
    with pytest.raises(SolidError, match="all its faces are collapsed"):
        solid.solidify("line", np.array([[0.0, 0, 0], [1, 0, 0], [1, 0, 0]]), np.array([[0, 1, 2]]))


def test_rebuilding_keeps_a_box_within_half_a_cell():
    fine = BOX.subdivide().subdivide()
    vertices, faces, step = rebuild.rebuild(*_arrays(fine), cells=40)
    assert is_solid(vertices, faces)
    assert distance_to_surface(vertices, *_arrays(fine)).max() < 0.5 * step
    assert measures.signed_volume(vertices, faces) == pytest.approx(1, rel=0.01)
    import igl  # the skipped blocks have the sign that the winding number has there

    points = np.random.default_rng(0).uniform(-0.47, 0.47, (200, 3))
    assert (igl.fast_winding_number(vertices, faces, points) > 0.99).all()
    assert (igl.fast_winding_number(vertices, faces, 2.2 * np.sign(points) - points) < 0.01).all()


def test_rebuilding_nothing_gives_nothing():
    flat = np.array([[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]], dtype=np.float64)
    assert len(rebuild.rebuild(flat, np.array([[0, 2, 1], [0, 3, 2]]), cells=24)[1]) == 0


def test_separated_vertices_differ_in_single_precision_too():
    both = joined(BOX, moved(BOX, 1, 1, 0))
    vertices, count = repair.separate(*_arrays(both))
    assert count == 4
    assert len(np.unique((100 * vertices).astype(np.float32), axis=0)) == 16


@pytest.mark.parametrize("name", ["triposr_house", "coral", "snapper"])
def test_real_assets_with_defects_come_out_solid(assets, name):
    found = asset.load(assets / f"{name}.glb")
    made = solidify(found.vertices, found.faces)
    assert made.report["bodies"] == 1
    assert not made.report["rebuilt"]


def test_real_assets_that_are_sound_pass_quickly(assets):
    for name in ("hunyuan_bus", "instantmesh_chair", "sf3d_raccoon", "teacup"):
        found = asset.load(assets / f"{name}.glb")
        start = time.process_time()
        made = solid.solidify(found.name, found.vertices, found.faces)
        assert time.process_time() - start < 3
        assert abs(len(made.faces) - len(found.faces)) < 5
        assert made.report["bodies"] == 1


def test_garbage_is_refused():
    """Before searches that would take minutes, and gigabytes."""
    points = np.random.default_rng(0).uniform(-1, 1, BALL.vertices.shape)
    with pytest.raises(SolidError, match="cuts through dozens of others"):
        solid.solidify("noise", points, np.array(BALL.faces))
    fan = np.column_stack([np.zeros(500, int), np.ones(500, int), np.arange(2, 502)])
    points = np.random.default_rng(0).uniform(-1, 1, (502, 3))
    with pytest.raises(SolidError, match="500 triangles meet at one edge"):
        solid.solidify("book", points, fan)

"""Welding, edges, bodies, holes and orientation on meshes small enough to count by hand."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from genmf_mi.mesh import topology

BOX = trimesh.creation.box()
BALL = trimesh.creation.icosphere(subdivisions=2)


def test_weld_merges_within_the_tolerance_and_keeps_the_order_of_faces():
    soup = BALL.triangles.reshape(-1, 3) + np.random.default_rng(0).uniform(-1e-7, 1e-7, (960, 3))
    vertices, faces = topology.weld(np.vstack([soup, [[9, 9, 9]]]), np.arange(960).reshape(-1, 3), 1e-6)
    assert vertices.shape == (162, 3)  # the stray vertex is left out
    np.testing.assert_allclose(vertices[faces], BALL.triangles, atol=1e-6)
    assert len(topology.weld(soup, np.arange(960).reshape(-1, 3), 1e-12)[0]) == 960


def test_counts_of_edges():
    assert topology.edge_counts(BOX.faces) == (0, 0)
    assert topology.edge_counts(BOX.faces[1:]) == (3, 0)
    fin = np.vstack([BOX.faces, [[*BOX.faces[0][:2], 8]]])
    assert topology.edge_counts(fin) == (2, 1)
    assert topology.open_faces(BOX.faces[1:]).sum() == 3


def test_closed_needs_two_faces_that_run_against_each_other():
    assert topology.is_closed(BOX.faces)
    assert not topology.is_closed(BOX.faces[1:])
    turned = BOX.faces.copy()
    turned[0] = turned[0][::-1]
    assert not topology.is_closed(turned)
    assert not topology.is_closed(np.empty((0, 3), dtype=np.int64))


def test_bodies_and_volume():
    both = trimesh.util.concatenate([BOX, BOX.copy().apply_translation([3, 0, 0])])
    label = topology.bodies(both.faces)
    assert label[:12].max() == label[:12].min() != label[12:].min() == label[12:].max()
    assert topology.volume(both.vertices + 100, both.faces) == pytest.approx(2)
    assert topology.volume(BOX.vertices, BOX.faces[:, ::-1]) == pytest.approx(-1)


def test_duplicates_go_whichever_way_they_run_round():
    again = np.vstack([BOX.faces, np.roll(BOX.faces, 1, axis=1), [[0, 0, 1]]])
    np.testing.assert_array_equal(topology.without_duplicates(again), topology.without_duplicates(BOX.faces))


def test_double_sided_export_keeps_one_side_and_a_fold_loses_both():
    double = np.vstack([BOX.faces, BOX.faces[:, ::-1]])
    assert len(topology.without_duplicates(double)) == 12
    one = BOX.faces[0]
    fold = np.vstack([BOX.faces, [[one[0], one[1], 8], [one[1], one[0], 8]]])
    kept = topology.without_duplicates(fold)
    assert topology.is_closed(kept)
    assert kept.max() == 7


@pytest.mark.parametrize("seed", range(3))
def test_orientation_is_restored_per_body(seed):
    both = trimesh.util.concatenate([BALL, BOX.copy().apply_translation([3, 0, 0])])
    flipped = np.random.default_rng(seed).random(len(both.faces)) < 0.4
    faces = both.faces.copy()
    faces[flipped] = faces[flipped][:, ::-1]
    found, changed = topology.oriented(both.vertices, faces)
    assert changed == flipped.sum()
    assert topology.is_closed(found)
    assert topology.volume(both.vertices, found) == pytest.approx(BALL.volume + 1)


def test_orientation_leaves_a_flat_sheet_as_it_is():
    sheet = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=np.float64) + 0.1
    for faces in ([[0, 1, 2], [0, 2, 3]], [[2, 1, 0], [3, 2, 0]]):
        assert topology.oriented(sheet, np.array(faces))[1] == 0


def test_rims_run_as_a_filling_face_would():
    hole = BALL.faces[1:]
    (loop,) = topology.boundary_loops(hole)
    assert topology.is_closed(np.vstack([hole, [loop]]))
    assert topology.boundary_loops(BALL.faces) == []


def test_holes_that_touch_in_a_vertex_have_a_rim_each():
    vertex = 0
    around = np.flatnonzero((BALL.faces == vertex).any(axis=1))
    first = around[0]
    apart = [f for f in around if len(set(BALL.faces[f]) & set(BALL.faces[first])) == 1][0]  # noqa: RUF015
    faces = np.delete(BALL.faces, [first, apart], axis=0)
    loops = topology.boundary_loops(faces)
    assert sorted(map(len, loops)) == [3, 3]
    assert topology.is_closed(np.vstack([faces, *[[loop] for loop in loops]]))


def test_distance_to_a_surface():
    points = np.array([[2.0, 0, 0], [0, 0, 0.1], [1, 1, 1]])
    np.testing.assert_allclose(topology.distance(points, BOX.vertices, BOX.faces), [1.5, 0.4, 0.75**0.5])


def test_vertex_normals_of_a_ball_point_outwards():
    normals = topology.vertex_normals(BALL.vertices, BALL.faces)
    np.testing.assert_allclose(normals, BALL.vertices, atol=0.03)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1)

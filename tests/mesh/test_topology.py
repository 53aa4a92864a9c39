"""Welding, edges, components, holes and orientation on meshes small enough to count by hand."""

from __future__ import annotations

import igl
import numpy as np
import pytest
import trimesh

from genmf_mi.mesh import measures, topology

BOX = trimesh.creation.box()
BALL = trimesh.creation.icosphere(subdivisions=2)


def test_weld_merges_within_the_tolerance_and_keeps_the_order_of_faces():
    soup = BALL.triangles.reshape(-1, 3) + np.random.default_rng(0).uniform(-1e-7, 1e-7, (960, 3))
    vertices, faces = topology.weld(np.vstack([soup, [[9, 9, 9]]]), np.arange(960).reshape(-1, 3), 1e-6)
    assert vertices.shape == (162, 3)  # the stray vertex is left out
    np.testing.assert_allclose(vertices[faces], BALL.triangles, atol=1e-6)
    assert len(topology.weld(soup, np.arange(960).reshape(-1, 3), 1e-12)[0]) == 960


def test_boundary_and_nonmanifold_edges():
    assert topology.boundary_and_nonmanifold_edges(BOX.faces) == (0, 0)
    assert topology.boundary_and_nonmanifold_edges(BOX.faces[1:]) == (3, 0)
    fin = np.vstack([BOX.faces, [[*BOX.faces[0][:2], 8]]])
    assert topology.boundary_and_nonmanifold_edges(fin) == (2, 1)
    assert topology.boundary_faces(BOX.faces[1:]).sum() == 3


def test_closed_needs_two_faces_that_run_against_each_other():
    assert topology.is_closed(BOX.faces)
    assert not topology.is_closed(BOX.faces[1:])
    turned = BOX.faces.copy()
    turned[0] = turned[0][::-1]
    assert not topology.is_closed(turned)
    assert not topology.is_closed(np.empty((0, 3), dtype=np.int64))


def components_by_merging(faces: np.ndarray) -> list[int]:
    """Component numbers by merging the sets of faces of every edge, one edge after the other."""
    number = list(range(len(faces)))
    around: dict[frozenset, list[int]] = {}
    for face, corners in enumerate(faces.tolist()):
        for k in range(3):
            around.setdefault(frozenset((corners[k], corners[k - 1])), []).append(face)
    for together in around.values():
        merged = {number[face] for face in together}
        number = [min(merged) if label in merged else label for label in number]
    names = sorted(set(number))
    return [names.index(label) for label in number]


@pytest.mark.parametrize("seed", range(20))
def test_components_of_random_faces(seed):
    """With boundary and non-manifold edges in plenty, and parts that touch in vertices only."""
    random = np.random.default_rng(seed)
    faces = np.array([random.permutation(30)[:3] for _ in range(random.integers(1, 60))])
    np.testing.assert_array_equal(topology.components(faces), components_by_merging(faces))


def test_boxes_that_share_a_vertex_are_two_components_and_along_an_edge_one():
    for offset, count in (((3, 0, 0), 2), ((1, 1, 1), 2), ((1, 1, 0), 1)):
        both = trimesh.util.concatenate([BOX, BOX.copy().apply_translation(offset)])
        _, faces = topology.weld(both.vertices, both.faces, 1e-6)
        assert topology.components(faces).max() + 1 == count


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
def test_orientation_is_restored_per_component(seed):
    both = trimesh.util.concatenate([BALL, BOX.copy().apply_translation([3, 0, 0])])
    flipped = np.random.default_rng(seed).random(len(both.faces)) < 0.4
    faces = both.faces.copy()
    faces[flipped] = faces[flipped][:, ::-1]
    turned, changed = topology.oriented(both.vertices, faces)
    assert changed == flipped.sum()
    assert topology.is_closed(turned)
    assert measures.signed_volume(both.vertices, turned) == pytest.approx(BALL.volume + 1)


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


def test_weld_of_clusters_that_are_far_apart():
    """Within each all are neighbours: as pairs they would not fit into memory."""
    cluster = np.random.default_rng(0).uniform(-1, 1, (3000, 3))
    points = np.concatenate([cluster, cluster + 1e8])
    vertices, faces = topology.weld(points, np.arange(6000).reshape(-1, 3), 100.0)
    assert len(vertices) == 2 and (faces == faces[:, :1]).all()


def test_components_are_numbered_in_the_order_of_the_faces():
    """As libigl has them, which lists all pairs of faces at an edge."""
    parts = [BALL, BOX, BALL]
    starts = np.cumsum([0] + [len(part.vertices) for part in parts[:-1]])
    faces = np.concatenate([np.array(part.faces) + start for part, start in zip(parts, starts, strict=True)])
    shuffled = np.random.default_rng(0).permutation(faces)
    found = topology.components(shuffled)
    assert np.array_equal(found, np.asarray(igl.facet_components(np.ascontiguousarray(shuffled))[1]))
    assert found[0] == 0 and found.max() == 2
    around_one_edge = np.column_stack([np.zeros(30_000, int), np.ones(30_000, int), np.arange(2, 30_002)])
    assert topology.components(around_one_edge).max() == 0 and topology.most_crowded_edge(around_one_edge) == 30_000

"""Areas, normals and volumes against plain formulas, also where they have no value."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from genmf_mi.mesh import measures

BOX = trimesh.creation.box()
BALL = trimesh.creation.icosphere(subdivisions=2)


@pytest.fixture(params=["float64", "float32 and int32", "a view"])
def mesh(request) -> tuple[np.ndarray, np.ndarray]:
    """A random closed mesh of triangles of very different sizes, as callers may hand it over."""
    vertices = BALL.vertices * np.random.default_rng(0).uniform(0.3, 1, (len(BALL.vertices), 1)) + 5
    vertices, faces = np.array(vertices), np.array(BALL.faces, dtype=np.int64)
    if request.param == "float32 and int32":
        return vertices.astype(np.float32), faces.astype(np.int32)
    return (vertices, faces) if request.param == "float64" else (np.asfortranarray(vertices), faces[:, [1, 2, 0]])


def crosses(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    a, b, c = (vertices[faces[:, k]].astype(np.float64) for k in range(3))
    return np.cross(b - a, c - a)


def test_areas_and_face_normals(mesh):
    cross = crosses(*mesh)
    length = np.linalg.norm(cross, axis=1)
    np.testing.assert_allclose(measures.face_areas(*mesh), length / 2, rtol=1e-12)
    np.testing.assert_allclose(measures.face_normals(*mesh), cross / length[:, None], rtol=1e-9, atol=1e-12)


def test_vertex_normals_are_weighted_by_area(mesh):
    vertices, faces = mesh
    expected = np.zeros(vertices.shape)
    for face, cross in zip(faces, crosses(*mesh), strict=True):
        expected[face] += cross
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    np.testing.assert_allclose(measures.vertex_normals(*mesh), expected, rtol=1e-9, atol=1e-12)


def test_vertex_normals_of_a_ball_point_outwards():
    normals = measures.vertex_normals(BALL.vertices, BALL.faces)
    np.testing.assert_allclose(normals, BALL.vertices, atol=0.03)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1)


def test_collapsed_faces_and_unused_vertices_have_no_normal():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0], [9, 9, 9]], dtype=np.float64)
    faces = np.array([[0, 1, 2], [0, 1, 3]])
    np.testing.assert_array_equal(measures.face_areas(vertices, faces), [0.5, 0])
    np.testing.assert_array_equal(measures.face_normals(vertices, faces), [[0, 0, 1], [0, 0, 0]])
    expected = [[0, 0, 1]] * 3 + [[0, 0, 0]] * 2
    np.testing.assert_array_equal(measures.vertex_normals(vertices, faces), expected)


def test_signed_volume():
    both = trimesh.util.concatenate([BOX, BOX.copy().apply_translation([3, 0, 0])])
    assert measures.signed_volume(both.vertices + 100, both.faces) == pytest.approx(2)
    assert measures.signed_volume(BOX.vertices, BOX.faces[:, ::-1]) == pytest.approx(-1)
    assert measures.signed_volume(BOX.vertices + 1e6, BOX.faces) == pytest.approx(1, rel=1e-9)


def test_volume_of_an_open_surface_is_that_of_the_cones_to_the_mean():
    lid = (BOX.triangles[:, :, 2] > 0.4).all(axis=1)
    assert lid.sum() == 2
    # The mean of the vertices is the centre: each of the six sides of the cube contributes a sixth
    assert measures.signed_volume(BOX.vertices + 7, BOX.faces[~lid]) == pytest.approx(5 / 6)

"""Distances, closest points and winding numbers of surfaces whose answers are known."""

from __future__ import annotations

import numpy as np
import trimesh

from genmf_mi.mesh.nearest import Nearest, barycentric, closest_points, distance_to_surface
from genmf_mi.mesh.winding import winding_number

BOX = trimesh.creation.box()
VERTICES, FACES = np.array(BOX.vertices), np.array(BOX.faces, dtype=np.int64)
POINTS = np.array([[2.0, 0, 0], [0, 0, 0.1], [1, 1, 1]])


def test_distance_to_a_surface():
    np.testing.assert_allclose(distance_to_surface(POINTS, VERTICES, FACES), [1.5, 0.4, 0.75**0.5])


def test_closest_points_lie_on_their_faces():
    points = np.random.default_rng(0).normal(size=(200, 3))
    index, closest, distance = closest_points(points, VERTICES, FACES)
    weights = barycentric(VERTICES[FACES[index]], closest)
    np.testing.assert_allclose(np.einsum("nk,nkc->nc", weights, VERTICES[FACES[index]]), closest, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(points - closest, axis=1), distance)
    tree = Nearest(VERTICES, FACES)
    for one, other in zip(tree.find(points)[1:], (closest, distance), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-12)


def test_faces_of_one_direction():
    points = np.zeros((1, 3))
    for axis in range(6):
        index, closest, distance = Nearest(VERTICES, FACES).find(points, axis)
        expected = np.eye(3)[axis % 3] * (0.5 if axis < 3 else -0.5)
        np.testing.assert_allclose(closest, [expected])
        np.testing.assert_allclose(BOX.face_normals[index], [2 * expected], atol=1e-12)
        np.testing.assert_allclose(distance, 0.5)
    lid = FACES[(VERTICES[FACES][:, :, 2] > 0.4).all(axis=1)]
    assert np.isinf(Nearest(VERTICES, lid).find(points, 0)[2]).all()


def test_winding_number_of_a_box_and_of_an_open_one():
    np.testing.assert_allclose(winding_number(POINTS, VERTICES, FACES), [0, 1, 0], atol=1e-3)
    np.testing.assert_allclose(winding_number(POINTS, VERTICES, FACES[:, ::-1]), [0, -1, 0], atol=1e-3)
    lid = (VERTICES[FACES][:, :, 2] > 0.4).all(axis=1)
    np.testing.assert_allclose(winding_number(np.zeros((1, 3)), VERTICES, FACES[~lid]), 5 / 6, atol=1e-3)

"""Self-intersections: the fast search with exact signs against brute force in rational numbers."""

from __future__ import annotations

from fractions import Fraction
from itertools import combinations

import numpy as np
import pytest
import trimesh

from genmf_mi.mesh.self_intersections import is_tangled, properly_intersecting, self_intersections


def sign(p, a, b, c) -> int:
    p, a, b, c = ([Fraction(float(x)) for x in point] for point in (p, a, b, c))
    u, v, w = ([x - y for x, y in zip(point, p, strict=True)] for point in (a, b, c))
    value = u[0] * (v[1] * w[2] - v[2] * w[1]) - u[1] * (v[0] * w[2] - v[2] * w[0]) + u[2] * (v[0] * w[1] - v[1] * w[0])
    return (value > 0) - (value < 0)


def pierces(p, q, triangle) -> bool:
    a, b, c = triangle
    if sign(p, a, b, c) * sign(q, a, b, c) >= 0:
        return False
    turns = [sign(p, q, x, y) for x, y in ((a, b), (b, c), (c, a))]
    return turns[0] != 0 and len(set(turns)) == 1


def brute_force(vertices: np.ndarray, faces: np.ndarray) -> list[int]:
    found = set()
    for one, other in combinations(range(len(faces)), 2):
        for first, second in ((one, other), (other, one)):
            for k in range(3):
                edge = faces[first][k], faces[first][(k + 1) % 3]
                if set(edge) & set(faces[second]) or len(set(faces[one]) & set(faces[other])) > 1:
                    continue
                if pierces(*vertices[list(edge)], vertices[faces[second]]):
                    found |= {one, other}
    return sorted(found)


@pytest.mark.parametrize("seed", range(4))
def test_random_triangles(seed):
    rng = np.random.default_rng(seed)
    vertices = rng.normal(size=(60, 3)) + np.repeat(rng.normal(size=(20, 3)) * 2, 3, axis=0)
    faces = np.arange(60).reshape(-1, 3)
    expected = brute_force(vertices, faces)
    assert 0 < len(expected) < 20
    np.testing.assert_array_equal(self_intersections(vertices, faces), expected)
    np.testing.assert_array_equal(properly_intersecting(vertices, faces, np.arange(20)), expected)


def test_triangles_that_share_one_corner():
    vertices = np.array([[0, 0, 0], [2, 0, 0], [0, 2, 0], [1, 1, -1], [1, 1, 1.5], [-1, -1, 1], [-1, -1, 2]], float) / 3
    through, beside = np.array([[0, 1, 2], [0, 3, 4]]), np.array([[0, 1, 2], [0, 5, 6]])
    # The opposite edge of the second face runs exactly through the edge 1–2 of the first: touching, not intersecting.
    assert len(properly_intersecting(vertices, through, np.arange(2))) == 0
    vertices[3:5] *= 0.9
    np.testing.assert_array_equal(self_intersections(vertices, through), [0, 1])
    assert len(self_intersections(vertices, beside)) == 0


def test_two_balls_intersect_each_other_and_one_does_not():
    ball = trimesh.creation.icosphere(subdivisions=3)
    assert len(self_intersections(ball.vertices, ball.faces)) == 0
    both = trimesh.util.concatenate([ball, ball.copy().apply_translation([0.7, 0.1, 0.05])])
    faces = self_intersections(both.vertices, both.faces)
    half = len(ball.faces)
    np.testing.assert_array_equal(faces, properly_intersecting(both.vertices, both.faces, np.arange(2 * half)))
    assert (faces < half).sum() > 50
    assert (faces >= half).sum() > 50


def test_slivers_side_by_side_in_one_plane_do_not_count():
    # Thin fans that fill a square exactly; rounding puts their corners on either side of the plane.
    turn = trimesh.transformations.rotation_matrix(0.7, [1, 2, 3])[:3, :3]
    x = np.linspace(0, 1, 400)
    square = np.concatenate([np.column_stack([x, 0 * x, 0 * x]), np.column_stack([x, 0 * x + 0.01, 0 * x])]) @ turn.T
    low, high = np.arange(399), np.arange(400, 799)
    faces = np.concatenate([np.column_stack([low, low + 1, high]), np.column_stack([low + 1, high + 1, high])])
    assert len(self_intersections(square, faces)) == 0
    assert len(properly_intersecting(square, faces, np.arange(len(faces)))) == 0


class TestTangled:
    def test_garbage(self):
        """It is told before the search, which would take minutes."""
        random = np.random.default_rng(0)
        ball = trimesh.creation.icosphere(3)
        for points in (random.uniform(-1, 1, ball.vertices.shape), random.integers(-2, 3, ball.vertices.shape) * 1.0):
            assert is_tangled(points, np.array(ball.faces))
        soup = random.uniform(-1, 1, (2000, 3, 3))
        assert is_tangled(soup.reshape(-1, 3), np.arange(6000).reshape(-1, 3))

    def test_bodies_that_overlap_are_none(self):
        """Sixty spikes through one point, and what is merely dense or finely cut."""
        turns = trimesh.transformations.random_rotation_matrix
        random = np.random.default_rng(0)
        spikes = [trimesh.creation.box((0.02, 0.02, 2), turns(random.random(3))) for _ in range(60)]
        for mesh in (trimesh.util.concatenate(spikes), trimesh.creation.cylinder(1, 1, sections=400),
                     trimesh.creation.icosphere(4)):  # fmt: skip
            assert not is_tangled(np.array(mesh.vertices), np.array(mesh.faces))

"""Φ against slow exact distances and winding numbers."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from genmf_mi.core.errors import SolidError
from genmf_mi.sdf.distance import axis, sample, signed_distance, thin_fraction


def brute_force(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Exact distance and winding number ``[N]``: the closest point over all triangles, the sum of solid angles."""
    a, b, c = (vertices[faces[:, i]][None] - points[:, None] for i in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=2) for v in (a, b, c))
    dot = lambda u, v: (u * v).sum(axis=2)  # noqa: E731
    angle = 2 * np.arctan2(dot(a, np.cross(b, c)), la * lb * lc + dot(a, b) * lc + dot(b, c) * la + dot(c, a) * lb)
    winding = angle.sum(axis=1) / (4 * np.pi)

    best = np.full(len(points), np.inf)
    for p, q in ((a, b), (b, c), (c, a)):
        t = np.clip(-dot(p, q - p) / dot(q - p, q - p), 0, 1)
        best = np.minimum(best, np.linalg.norm(p + t[..., None] * (q - p), axis=2).min(axis=1))
    n = np.cross(b - a, c - a)
    height = dot(n, a) / np.linalg.norm(n, axis=2)
    foot = height[..., None] * n / np.linalg.norm(n, axis=2, keepdims=True)
    over = np.all([dot(np.cross(q - p, foot - p), n) >= 0 for p, q in ((a, b), (b, c), (c, a))], axis=0)
    best = np.minimum(best, np.where(over, abs(height), np.inf).min(axis=1))
    return best, winding


def check(vertices: np.ndarray, faces: np.ndarray, n: int = 25) -> np.ndarray:
    phi = signed_distance(vertices, faces, n)
    ticks = axis(n)
    points = np.stack(np.meshgrid(ticks, ticks, ticks, indexing="ij"), axis=-1).reshape(-1, 3)
    exact, winding = (value.reshape(n, n, n) for value in brute_force(points, vertices, faces))
    cell = 2 / (n - 1)
    # The fast winding number is an approximation; where the exact one is about one half, either sign is right.
    sure = (exact > 1e-6) & (abs(winding - 0.5) > 0.02)
    assert ((phi < 0) == (winding > 0.5))[sure].all()
    magnitude, near = abs(phi), exact < 2 * cell
    assert np.allclose(magnitude[near], exact[near], atol=1e-6)
    assert (magnitude > exact - 1e-6).all()
    assert (magnitude - exact).max() < 1.5 * cell and (magnitude - exact).mean() < 0.12 * cell
    return phi


def test_box_and_ball() -> None:
    mesh = trimesh.creation.box((1.2, 1.9, 0.7))
    check(mesh.vertices, mesh.faces)
    mesh = trimesh.creation.icosphere(subdivisions=1, radius=0.9)
    check(mesh.vertices, mesh.faces)


def test_thin_wall_keeps_its_sign() -> None:
    """A plate between two layers of samples: no sample is a cell inside, yet those within must be found."""
    plate = trimesh.creation.box((1.9, 0.1, 1.9))
    plate.apply_translation((0, 1 / 12, 0))
    phi = check(plate.vertices, plate.faces)
    assert (phi < 0).sum() == 23 * 23


def test_open_and_self_touching_surfaces() -> None:
    ball = trimesh.creation.icosphere(subdivisions=1, radius=0.8)
    opened = ball.faces[np.argsort(ball.triangles_center[:, 1])[:-6]]
    assert check(ball.vertices, opened)[12, 12, 12] < 0, "a hole wider than a cell does not let the outside in"
    other = ball.vertices * 0.5 + [0.0, 0.45, 0.0]
    both = np.concatenate([ball.faces, ball.faces + len(ball.vertices)])
    phi = signed_distance(np.concatenate([ball.vertices, other]), both, 25)
    assert phi[12, 12, 12] < 0, "the inside of two overlapping bodies is inside"


def test_refusals() -> None:
    ball = trimesh.creation.icosphere(subdivisions=1, radius=0.8)
    with pytest.raises(SolidError, match="no faces"):
        signed_distance(ball.vertices, np.zeros((0, 3), dtype=int), 25)
    with pytest.raises(SolidError, match="not numbers"):
        signed_distance(np.where(ball.vertices > 0.75, np.nan, ball.vertices), ball.faces, 25)
    with pytest.raises(SolidError, match="encloses nothing"):
        signed_distance(ball.vertices, ball.faces[:, ::-1], 25)
    flat = np.array([[-0.9, 0.01, -0.9], [0.9, 0.01, -0.9], [0.0, 0.01, 0.9]])
    with pytest.raises(SolidError, match="encloses nothing"):
        signed_distance(flat, np.array([[0, 1, 2], [2, 1, 0]]), 25)


def test_sample_is_trilinear() -> None:
    ticks = axis(17)
    x, y, z = np.meshgrid(ticks, ticks, ticks, indexing="ij")
    points = np.random.default_rng(0).uniform(-1, 1, (50, 3))
    assert np.allclose(sample(1 + x - 2 * y + 3 * z, points), 1 + points @ [1, -2, 3])


def test_thinness_is_reported() -> None:
    thick = trimesh.creation.box((1.9, 0.8, 0.8))
    assert thin_fraction(thick.vertices, thick.faces, signed_distance(thick.vertices, thick.faces, 65)) < 0.08
    thin = trimesh.creation.box((1.9, 0.04, 1.9))
    assert thin_fraction(thin.vertices, thin.faces, signed_distance(thin.vertices, thin.faces, 65)) > 0.9

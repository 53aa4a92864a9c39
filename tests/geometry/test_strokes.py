"""Strokes of a brush against a slow oracle that walks over all points and all segments."""

from __future__ import annotations

import numpy as np
import pytest
from toys import sphere

from genmf_mi.core.regions import Stroke
from genmf_mi.geometry.strokes import AGREEMENT, painted, stroke_distance

REACH = 3.0


def brute_force(points, normals, stroke, reach):
    """Signed distance to a stroke, one point and one segment at a time; infinite from ``reach`` on."""
    result = np.full(len(points), np.inf)
    facing = [n / np.linalg.norm(n) for n in stroke.normals]
    ends = [(0, 0)] if len(stroke.points) == 1 else [(i, i + 1) for i in range(len(stroke.points) - 1)]
    for i, (point, normal) in enumerate(zip(points, normals, strict=True)):
        for a, b in ends:
            start, along = stroke.points[a], stroke.points[b] - stroke.points[a]
            length = np.sqrt(along @ along)
            share = 0.0 if length == 0 else min(max((point - start) @ along / length**2, 0), 1)
            distance = np.sqrt(((point - start - share * along) ** 2).sum()) - stroke.radius_mm
            mixed = (1 - share) * facing[a] + share * facing[b]
            turned = -(mixed / np.linalg.norm(mixed)) @ normal / AGREEMENT * (stroke.radius_mm + reach)
            result[i] = min(result[i], max(distance, turned))
    return np.where(result < reach, result, np.inf)


@pytest.fixture(scope="module")
def ball():
    vertices, _, normals = sphere(3, radius=20.0)
    return vertices, normals


def wander(seed: int, kind="flat", count=6, radius=4.0, factor=2.0) -> Stroke:
    directions = np.cumsum(np.random.default_rng(seed).normal(size=(count, 3)), axis=0)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return Stroke(kind, 20 * directions, 3 * directions, radius, factor)


class TestOneStroke:
    @pytest.mark.parametrize("count", [1, 2, 7])
    def test_as_the_oracle(self, ball, count):
        stroke = wander(count, count=count)
        rows, distance = stroke_distance(*ball, stroke, REACH)
        ours = np.full(len(ball[0]), np.inf)
        ours[rows] = distance
        expected = brute_force(*ball, stroke, REACH)
        assert (expected < 0).sum() > 5 and np.isinf(expected).any()
        np.testing.assert_allclose(ours, expected, atol=1e-9)

    def test_a_dab_on_a_plane_is_round(self):
        x, y = (a.ravel() for a in np.meshgrid(np.linspace(-6, 6, 25), np.linspace(-6, 6, 25)))
        points, up = np.stack([x, y, 0 * x], axis=1), np.tile([0.0, 0.0, 1.0], (len(x), 1))
        rows, distance = stroke_distance(points, up, Stroke("flat", [[1, 0, 0]], [[0, 0, 9]], 2.0), REACH)
        np.testing.assert_allclose(distance, np.maximum(np.hypot(x - 1, y) - 2, -20)[rows], atol=1e-12)

    def test_the_back_of_a_thin_wall_is_not_painted(self):
        points = np.array([[0, 0, 0.5], [0, 0, -0.5], [0, 2, 0.5], [3.5, 0, 0.0]])
        normals = np.array([[0, 0, 1], [0, 0, -1], [0, 0.6, 0.8], [1.0, 0, 0]])
        stroke = Stroke("flat", [[0, 0, 0.5], [1, 0, 0.5]], [[0, 0, 1], [0, 0, 1]], 4.0)
        rows, distance = stroke_distance(points, normals, stroke, 2.0)
        assert set(rows) == {0, 2, 3}, "also not in the fade"
        assert (distance <= 1e-12).all(), "at a right angle it still is"


class TestManyStrokes:
    def test_later_strokes_override_earlier_ones(self, ball):
        """Against sets of points: each is of the last stroke that covers it."""
        strokes = [wander(1), wander(2, "stronger", factor=3), wander(3, "erase"), wander(4), wander(5, "matters")]
        strokes += [wander(6, "stronger"), wander(1, "erase", radius=2.0)]
        last = np.full(len(ball[0]), -1)
        for number, stroke in enumerate(strokes):
            last[brute_force(*ball, stroke, REACH) <= 0] = number
        found = painted(*ball, strokes, REACH)
        assert set(found) == {("flat", 1.0), ("stronger", 3.0), ("stronger", 2.0), ("matters", 2.0)}
        wanted = {("flat", 1.0): (0, 3), ("stronger", 3.0): (1,), ("stronger", 2.0): (5,), ("matters", 2.0): (4,)}
        for label, numbers in wanted.items():
            assert np.isin(last, numbers).sum() > 3
            np.testing.assert_array_equal(found[label] < 0, np.isin(last, numbers), err_msg=str(label))

    def test_continuous_along_the_surface(self, ball):
        """What is erased in the middle of a stroke ends smoothly too."""
        points, normals = ball
        along = np.linspace(0, 1, 400)[:, None]
        points = np.concatenate([points, np.array([0.0, 0, 20]) + along * [30, 0, 0]])
        normals = np.concatenate([normals, np.tile([0.0, 0, 1], (400, 1))])
        big, small = (Stroke(k, [[10, 0, 20]], [[0, 0, 1]], r) for k, r in (("flat", 8.0), ("erase", 3.0)))
        line = painted(points, normals, [big, small], REACH)["flat", 1.0][-400:]
        seen = np.isfinite(line)
        assert np.abs(np.diff(line[seen])).max() < 30 / 399 + 1e-9 or not seen.all()
        assert (line[np.abs(30 * along[:, 0] - 10) < 2.9] > 0).all()
        assert (line[(np.abs(30 * along[:, 0] - 10) > 3.1) & (np.abs(30 * along[:, 0] - 10) < 7.9)] < 0).all()

"""The frames: file units, normalised, and millimetres on the bed."""

from __future__ import annotations

import numpy as np
import pytest

from genmf_mi.core.frame import Frame

UPS = [(0, 1, 0), (0, -1, 0), (1, 0, 0), (0, 0, -1), (0.6, 0, 0.8), (0.36, -0.48, 0.8)]


@pytest.fixture
def points() -> np.ndarray:
    return np.random.default_rng(0).normal(size=(20, 3))


class TestPrintFrame:
    @pytest.mark.parametrize("up", UPS)
    def test_there_and_back(self, points, up):
        frame = Frame.of(points, 80.0).standing(up)
        normalised = frame.normalise(points)
        back = frame.from_print(frame.to_print(normalised), float((normalised @ up).min()))
        np.testing.assert_allclose(back, normalised, atol=1e-12)

    @pytest.mark.parametrize("up", UPS)
    def test_a_rotation_that_takes_up_to_z_and_the_lowest_point_to_the_bed(self, points, up):
        frame = Frame.of(points, 80.0).standing(up)
        axes = frame.turned_to_print(np.eye(3))
        np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(axes) == pytest.approx(1)
        np.testing.assert_allclose(frame.turned_to_print(np.array([up])), [[0, 0, 1]], atol=1e-12)
        assert frame.to_print(points)[:, 2].min() == 0

    def test_upright_is_a_quarter_turn_about_x(self, points):
        frame = Frame((0.0, 0.0, 0.0), 1.0, 1.9)
        x, y, z = points.T
        np.testing.assert_array_equal(frame.to_print(points), np.stack([x, -z, y - y.min()], axis=1))

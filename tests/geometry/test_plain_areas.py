"""What counts as plain, and how far it may move."""

from __future__ import annotations

import numpy as np
import pytest

from genmf_mi.geometry.displacement_bounds import DisplacementBounds
from genmf_mi.geometry.plain_areas import (
    GROUPS_PER_RADIUS,
    PLAIN_CAP_MM,
    RADIUS_MM,
    RAMP_MM,
    brightness_range,
    is_plain,
    relief_cap,
)


@pytest.fixture(scope="module")
def plate() -> np.ndarray:
    """Points on a plate of 80 × 40 mm, half a millimetre apart."""
    x, z = np.meshgrid(np.arange(0, 80, 0.5), np.arange(0, 40, 0.5), indexing="ij")
    return np.stack([x.ravel(), np.zeros(x.size), z.ravel()], axis=1)


def edge_at(points: np.ndarray, place: float, contrast: float) -> np.ndarray:
    return np.where(points[:, 0] < place, 0.4, 0.4 + contrast)


class TestBrightnessRange:
    def test_within_the_brute_force_of_a_little_less_and_a_little_more(self):
        rng = np.random.default_rng(0)
        points, brightness, radius = rng.uniform(0, 10, (400, 3)), rng.uniform(0, 1, 400), 2.0
        away = np.linalg.norm(points[:, None] - points, axis=2)
        slack = np.sqrt(3) * radius / GROUPS_PER_RADIUS
        less, more = (
            [np.ptp(brightness[row <= radius + change]) for row in away] for change in (-2 * slack, 2 * slack)
        )
        measured = brightness_range(points, brightness, radius)
        assert (measured >= np.array(less) - 1e-12).all() and (measured <= np.array(more) + 1e-12).all()

    def test_one_point(self):
        assert brightness_range(np.zeros((1, 3)), np.ones(1), 6.0).tolist() == [0.0]


class TestIsPlain:
    def test_away_from_an_edge(self, plate):
        plain = is_plain(plate, edge_at(plate, 30.0, 0.3))
        assert plain[np.abs(plate[:, 0] - 30) > RADIUS_MM + 1].all()
        assert not plain[np.abs(plate[:, 0] - 30) < RADIUS_MM - 1].any()

    def test_faint_contrast_is_plain_and_a_slow_change_is_not(self, plate):
        assert is_plain(plate, edge_at(plate, 30.0, 0.05)).all()
        assert not is_plain(plate, 0.01 * plate[:, 0])[(plate[:, 0] > 6) & (plate[:, 0] < 74)].any()


class TestReliefCap:
    def test_full_beside_the_texture_little_on_plain_areas_a_ramp_between(self, plate):
        cap = relief_cap(plate, edge_at(plate, 30.0, 0.3), 1.0)
        away = np.abs(plate[:, 0] - 30)
        assert (cap[away < RADIUS_MM - RAMP_MM - 1] == 1).all()
        assert (cap[away > RADIUS_MM + 1] == PLAIN_CAP_MM).all()
        row = cap[(plate[:, 2] == 20) & (plate[:, 0] >= 30)]
        assert (np.diff(row) <= 1e-12).all() and (np.diff(row) >= -0.5 / RAMP_MM - 1e-9).all()

    def test_never_more_than_the_cap(self, plate):
        assert (relief_cap(plate, edge_at(plate, 30.0, 0.3), 0.05) == 0.05).all()

    @pytest.mark.parametrize("brightness", [lambda x: np.full(len(x), 0.5), lambda x: np.sin(x[:, 0])])
    def test_plain_or_textured_all_over(self, plate, brightness):
        assert (relief_cap(plate, brightness(plate), 1.0) == 1.0).all()


def test_bounds_with_another_cap():
    bounds = DisplacementBounds(np.array([0.5, 0.9, 0.0]), np.array([0.9, 0.2, 0.9]), np.array([0.2, 0.1, 0.0]))
    cap = np.array([0.1, 1.0, 0.5])
    capped = bounds.capped(cap)
    for one, other in ((capped.inward, bounds.inward), (capped.outward, bounds.outward)):
        assert (one <= other).all() and (np.hypot(one, capped.tangential) <= cap + 1e-12).all()
    assert capped.inward[1] == 0.9 and capped.outward[1] == 0.2 and capped.tangential[0] < 0.1

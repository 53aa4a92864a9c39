"""What counts as detail: on a ball with one thin stripe."""

from __future__ import annotations

import numpy as np
from toys import sphere

from genmf_mi.assets.asset import Asset
from genmf_mi.pipeline.detail import SOFT, crispness, local_contrast, local_range, span


def painted(grey: np.ndarray) -> Asset:
    vertices, faces, _ = sphere(6)
    return Asset.from_arrays("painted", vertices, faces, colours=np.repeat(np.float32(grey)[:, None], 3, axis=1))


def striped() -> Asset:
    """A dark ring of 0.04 on a bright ball of radius 1."""
    vertices, _, _ = sphere(6)
    return painted(np.where(np.abs(vertices[:, 1]) < 0.02, 0.05, 0.7))


def test_local_range_finds_strokes_thinner_than_the_triangles():
    vertices, faces, _ = sphere(3)  # edges of 0.15
    contrast = local_range(striped(), vertices, faces)
    across = vertices[faces, 1]
    crossed = (across.min(axis=1) < -0.01) & (across.max(axis=1) > 0.01)
    assert (contrast[crossed] > 0.3).mean() > 0.95
    assert (contrast[np.abs(across).min(axis=1) > 0.4] == 0).all()


def test_stripes_are_crisp_and_waves_are_soft():
    vertices, faces, _ = sphere(4)
    fine, _, _ = sphere(6)
    soft = painted(0.4 + 0.1 * np.sin(8 * fine[:, 1]))
    for asset, low, high in ((striped(), 0.8, 1.0), (soft, 0.0, SOFT)):
        assert low <= crispness(vertices, faces, local_range(asset, vertices, faces)) <= high


class TestSmallFeatures:
    """Eyes are less than a hundredth of a figure, and what a person looks at first."""

    def eyes(self, radius: float, dark: float) -> tuple[np.ndarray, np.ndarray]:
        """Brightness of a ball with two discs, and its broad component, which hardly sees them."""
        vertices, _, _ = sphere(6)
        centres = np.array([[0.4, 0.3, 0.866], [-0.4, 0.3, 0.866]])
        nearest = np.linalg.norm(vertices[:, None] - centres, axis=2).min(axis=1)
        return np.where(nearest < radius, dark, 0.8), np.full(len(vertices), 0.8)

    def test_strong_ones_count(self):
        brightness, broad = self.eyes(0.1, 0.1)
        assert 0.001 < (brightness < 0.5).mean() < 0.01
        assert local_contrast(np.abs(brightness - broad)) > 0.5
        assert span(brightness) == (0.1, 0.8)

    def test_faint_ones_and_specks_do_not(self):
        for brightness, broad in (self.eyes(0.1, 0.7), self.eyes(0.02, 0.1)):
            assert local_contrast(np.abs(brightness - broad)) < 0.01
            low, high = span(brightness)
            assert high - low < 0.01

    def test_where_there_is_much_to_see_a_hundredth_is_left_out(self):
        vertices, _, _ = sphere(6)
        brightness = np.where(vertices[:, 1] > 0, 0.7, 0.3)
        brightness[:100] = 1.0
        assert span(brightness) == (0.3, 0.7)

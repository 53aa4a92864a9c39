"""Colours of a rendered field; what the sheets show is tested with the commands."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib import colormaps

from genmf_mi.core.colour import to_linear, to_srgb
from genmf_mi.stress.report import picture


def test_light_scales_linear_colours() -> None:
    """A colour under half of the light is half as bright in linear RGB, and as in the colour bar under full light."""
    value = np.full((4, 4), 0.4)
    for light in (0.5, 1.0):
        shade = np.full((4, 4), (light - 0.25) / 0.95)
        image = picture.colourise(picture.RenderedField(shade, value, np.ones((4, 4), dtype=bool)), 0.8)
        colour = np.array(colormaps[picture.COLOURS](0.5)[:3])
        assert image.shape == (2, 2, 3)
        np.testing.assert_allclose(image, np.broadcast_to(to_srgb(light * to_linear(colour)), (2, 2, 3)), atol=1e-6)


def test_background_is_white_in_full_light() -> None:
    shade = np.ones((2, 2))
    image = picture.colourise(picture.RenderedField(shade, np.zeros((2, 2)), np.zeros((2, 2), dtype=bool)), 1.0)
    assert image.min() > 0.98 and image.max() == pytest.approx(1.0)


def test_the_camera_sees_all_of_the_object() -> None:
    """From any side, no vertex is outside of the pyramid that the sensor sees."""
    vertices = np.random.default_rng(0).uniform(-1, 1, (200, 3)) * [0.9, 0.3, 0.6]
    half = np.tan(np.radians(picture._FIELD_OF_VIEW / 2))
    for azimuth, elevation in ((0.0, 0.0), (35.0, 20.0), (215.0, 60.0)):
        camera = picture._Camera.around(vertices, azimuth, elevation)
        forward = camera.centre - camera.origin
        forward /= np.linalg.norm(forward)
        depth = (vertices - camera.origin) @ forward
        right = np.cross(forward, [0.0, 1.0, 0.0])
        right /= np.linalg.norm(right)
        across = [(vertices - camera.origin) @ axis for axis in (right, np.cross(right, forward))]
        assert np.abs(across).max(axis=0).max() > 0 and (np.abs(across) < half * depth).all()

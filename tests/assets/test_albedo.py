"""Texture lookup against a scalar oracle that follows the rules of a graphics card one texel at a time."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from genmf_mi.assets.albedo import CLAMP, MIRROR, REPEAT, Albedo, Material, Texture
from genmf_mi.core.colour import to_linear


def wrapped(index: int, size: int, rule: str) -> int:
    if rule == CLAMP:
        return min(max(index, 0), size - 1)
    if rule == MIRROR:
        period, inside = divmod(index, size)
        return inside if period % 2 == 0 else size - 1 - inside
    return index % size


def looked_up(pixels: np.ndarray, u: float, v: float, rules: tuple[str, str], nearest: bool) -> np.ndarray:
    height, width, _ = pixels.shape
    linear = to_linear(pixels / 255)

    def texel(column: int, row: int) -> np.ndarray:
        return linear[wrapped(row, height, rules[1]), wrapped(column, width, rules[0])]

    if nearest:
        return texel(math.floor(u * width), math.floor(v * height))
    x, y = u * width - 0.5, v * height - 0.5
    column, row = math.floor(x), math.floor(y)
    s, t = x - column, y - row
    upper = texel(column, row) * (1 - s) + texel(column + 1, row) * s
    lower = texel(column, row + 1) * (1 - s) + texel(column + 1, row + 1) * s
    return upper * (1 - t) + lower * t


@pytest.mark.parametrize("rules", list(itertools.product((REPEAT, CLAMP, MIRROR), repeat=2)), ids="-".join)
@pytest.mark.parametrize("nearest", [False, True])
def test_lookup_agrees_with_the_oracle(rules, nearest):
    rng = np.random.default_rng(0)
    pixels = rng.integers(0, 256, (3, 5, 3), dtype=np.uint8)
    uv = rng.uniform(-2.5, 2.5, (200, 2))
    expected = [looked_up(pixels, u, v, rules, nearest) for u, v in uv]
    found = Texture(pixels, rules, nearest).sample(uv)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, expected, atol=1e-5)


def test_interpolation_is_in_linear_light():
    pixels = np.array([[[0, 0, 0], [255, 255, 255]]], dtype=np.uint8)
    # Half way between black and white is half of the light, not half of the code (which would be 0.214).
    np.testing.assert_allclose(Texture(pixels, (CLAMP, CLAMP)).sample(np.array([[0.5, 0.5]])), 0.5, atol=1e-6)


def test_factor_texture_and_vertex_colours_multiply_per_material():
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    grey = Texture(np.full((1, 1, 3), 188, dtype=np.uint8))
    albedo = Albedo(
        materials=(Material((0.5, 1.0, 0.25), grey), Material((0.1, 0.2, 0.3))),
        material=np.array([0, 1]),
        uv=np.zeros((4, 2)),
        colours=np.array([[1, 1, 1], [0, 1, 1], [0.5, 1, 1], [1, 1, 1]], dtype=np.float32),
    )
    third = np.full((2, 3), 1 / 3)
    found = albedo.sample(faces, np.array([0, 1]), third)
    light = to_linear(188 / 255)
    np.testing.assert_allclose(found[0], [0.5 * light * 0.5, light, 0.25 * light], rtol=1e-5)
    np.testing.assert_allclose(found[1], [0.1 * 2.5 / 3, 0.2, 0.3], rtol=1e-5)


@pytest.mark.parametrize(
    ("factors", "colours", "varies"),
    [
        ([(1.0, 1.0, 1.0)], np.ones((3, 3)), False),
        ([(1.0, 0.0, 0.0), (1.0, 0.0, 0.0)], np.ones((3, 3)), False),
        ([(1.0, 0.0, 0.0), (0.0, 1.0, 0.0)], np.ones((3, 3)), True),
        ([(1.0, 1.0, 1.0)], np.array([[1, 1, 1], [1, 1, 1], [1, 1, 0.9]]), True),
    ],
)
def test_varies_says_whether_there_is_anything_to_show(factors, colours, varies):
    count = len(factors)
    albedo = Albedo(
        tuple(Material(factor) for factor in factors), np.arange(count), np.zeros((3, 2)), colours.astype(np.float32)
    )
    assert albedo.varies is varies

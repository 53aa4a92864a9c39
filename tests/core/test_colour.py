"""sRGB against the published reference values, and the value channel."""

from __future__ import annotations

import numpy as np

from genmf_mi.core import colour


def test_reference_values():
    # IEC 61966-2-1: the linear part, the break, mid grey and the ends.
    encoded = np.array([0, 0.02, 0.04045, 0.5, 0.735357, 1])
    linear = np.array([0, 0.02 / 12.92, 0.0031308, 0.2140411, 0.5, 1])
    np.testing.assert_allclose(colour.to_linear(encoded), linear, atol=2e-7)
    np.testing.assert_allclose(colour.to_srgb(linear), encoded, atol=2e-5)


def test_both_ways_cancel():
    values = np.linspace(0, 1, 1001, dtype=np.float32)
    np.testing.assert_allclose(colour.to_srgb(colour.to_linear(values)), values, atol=2e-6)


def test_bytes_agree_with_the_formula_and_survive_the_round_trip():
    every = np.arange(256, dtype=np.uint8)
    linear = colour.bytes_to_linear(every)
    np.testing.assert_array_equal(linear, colour.to_linear(every / 255))
    np.testing.assert_array_equal(np.rint(colour.to_srgb(linear) * 255), every)
    assert linear.dtype == np.float32


def test_value_is_the_largest_channel():
    rgb = np.array([[[0.1, 0.7, 0.3], [0.2, 0.1, 0.0]]], dtype=np.float32)
    np.testing.assert_array_equal(colour.value(rgb), np.array([[0.7, 0.2]], dtype=np.float32))

"""sRGB against published reference values and a slow oracle, on arrays and tensors; and the value channel."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
import torch

from genmf_mi.core import colour

# From well below 0 to above 1, with both breaks and their neighbours.
VALUES = np.concatenate([np.linspace(-0.3, 1.3, 401), [0, 0.0031308, 0.0031309, 0.04045, 0.04046, 1]])


def srgb(linear: float) -> float:
    """IEC 61966-2-1, one number at a time."""
    linear = max(linear, 0.0)
    return 12.92 * linear if linear <= 0.0031308 else 1.055 * linear ** (1 / 2.4) - 0.055


def linear(encoded: float) -> float:
    encoded = max(encoded, 0.0)
    return encoded / 12.92 if encoded <= 0.04045 else ((encoded + 0.055) / 1.055) ** 2.4


BOTH = pytest.mark.parametrize(("function", "oracle"), [(colour.to_srgb, srgb), (colour.to_linear, linear)])


def test_reference_values():
    # IEC 61966-2-1: the linear part, the break, mid grey and the ends.
    encoded = np.array([0, 0.02, 0.04045, 0.5, 0.735357, 1])
    linear = np.array([0, 0.02 / 12.92, 0.0031308, 0.2140411, 0.5, 1])
    np.testing.assert_allclose(colour.to_linear(encoded), linear, atol=2e-7)
    np.testing.assert_allclose(colour.to_srgb(linear), encoded, atol=2e-5)


@BOTH
def test_arrays_against_the_oracle(function, oracle):
    expected = [oracle(float(x)) for x in VALUES]
    result = function(VALUES.reshape(11, 37))
    assert result.dtype == np.float32 and result.shape == (11, 37)
    np.testing.assert_allclose(result.reshape(-1), expected, atol=1e-6)
    assert function(np.float32(0.5)) == pytest.approx(oracle(0.5), abs=1e-6)


@BOTH
@pytest.mark.parametrize(("dtype", "atol"), [(torch.float32, 1e-6), (torch.float64, 1e-12)])
def test_tensors_against_the_oracle(function, oracle, dtype, atol):
    values = torch.tensor(VALUES, dtype=dtype).reshape(11, 37)
    result = function(values)
    assert result.dtype == dtype and result.shape == (11, 37)
    expected = [oracle(x) for x in values.reshape(-1).tolist()]
    np.testing.assert_allclose(result.reshape(-1), expected, atol=atol)


@BOTH
def test_gradients_against_differences_of_the_oracle(function, oracle):
    """Finite everywhere: the slope of the line at 0, zero below."""
    values = torch.tensor(VALUES, dtype=torch.float64, requires_grad=True)
    (gradient,) = torch.autograd.grad(function(values).sum(), values)
    step = 1e-7
    for x, slope in zip(VALUES.tolist(), gradient.tolist(), strict=True):
        right, left = (oracle(x + step) - oracle(x)) / step, (oracle(x) - oracle(x - step)) / step
        # At a break either side's slope is right; the two pieces themselves differ there by 1e-8 at most
        assert min(abs(slope - right), abs(slope - left)) < 1e-4 * max(1, abs(slope))
    at_zero = torch.zeros(1, requires_grad=True)
    function(at_zero).sum().backward()
    assert at_zero.grad.item() == pytest.approx(12.92 if oracle is srgb else 1 / 12.92)


def test_both_ways_cancel():
    values = np.linspace(0, 1, 1001, dtype=np.float32)
    np.testing.assert_allclose(colour.to_srgb(colour.to_linear(values)), values, atol=2e-6)


def test_arrays_do_not_load_torch():
    code = "import sys; from genmf_mi.core import colour; colour.to_srgb([0.5]); print('torch' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, encoding="utf-8", check=True)
    assert done.stdout.strip() == "False"


def test_bytes_agree_with_the_formula_and_survive_the_round_trip():
    every = np.arange(256, dtype=np.uint8)
    linear = colour.bytes_to_linear(every)
    np.testing.assert_array_equal(linear, colour.to_linear(every / 255))
    np.testing.assert_array_equal(np.rint(colour.to_srgb(linear) * 255), every)
    assert linear.dtype == np.float32


def test_value_is_the_largest_channel():
    rgb = np.array([[[0.1, 0.7, 0.3], [0.2, 0.1, 0.0]]], dtype=np.float32)
    np.testing.assert_array_equal(colour.value(rgb), np.array([[0.7, 0.2]], dtype=np.float32))

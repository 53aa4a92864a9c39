"""Uniform Adam: against its formula, robust against spikes and gradients that are no numbers."""

from __future__ import annotations

import copy
import subprocess
import sys

import numpy as np
import pytest
import torch
from toys import noise

from genmf_mi.geometry.uniform_adam import UniformAdam


class TestUniformAdam:
    def test_against_the_formula(self):
        """Ten steps of plain NumPy."""
        parameter = torch.zeros(200, 3, requires_grad=True)
        adam = UniformAdam([parameter], 0.1, betas=(0.8, 0.95))
        x, first, second = np.zeros((200, 3)), np.zeros((200, 3)), np.zeros((200, 3))
        for step in range(1, 11):
            gradient = noise(200, 3, seed=step) ** 3
            parameter.grad = torch.tensor(gradient, dtype=torch.float32)
            adam.step()
            limit = 10 * np.sort(np.abs(gradient).ravel())[593]
            gradient = np.clip(gradient, -limit, limit)
            first, second = 0.8 * first + 0.2 * gradient, 0.95 * second + 0.05 * gradient**2
            scale = np.sqrt(np.sort(second.ravel())[593] / (1 - 0.95**step))
            x -= 0.1 * first / (1 - 0.8**step) / scale
            assert adam.scale == pytest.approx(scale, rel=1e-4)
        np.testing.assert_allclose(parameter.detach(), x, atol=1e-4)
        assert parameter.grad is None

    def test_parameters_are_apart(self):
        """Each is scaled by its own gradients and has its own learning rate, as if it were alone."""
        together = [torch.zeros(count, requires_grad=True) for count in (100, 200)]
        alone = [torch.zeros(count, requires_grad=True) for count in (100, 200)]
        adam, single = UniformAdam(together, 0.1), [UniformAdam([p], 0.1) for p in alone]
        for seed in range(3):
            for one, other, size in zip(together, alone, (1.0, 1e-4)):
                gradient = torch.tensor(noise(len(one), seed=seed) * size, dtype=torch.float32)
                one.grad, other.grad = gradient.clone(), gradient.clone()
            adam.rates = [0.2, 0.05]
            adam.step()
            for optimiser, rate in zip(single, (0.2, 0.05)):
                optimiser.rates = [rate]
                optimiser.step()
        for one, other in zip(together, alone):
            torch.testing.assert_close(one, other)
        assert adam.scale == single[0].scale

    def test_first_step_is_the_rate_where_the_gradient_is_uniform(self):
        parameter = torch.zeros(100, 3, requires_grad=True)
        for rate in (0.5, 0.02):
            before = parameter.detach().clone()
            parameter.grad = torch.full((100, 3), -1e-7)
            UniformAdam([parameter], rate).step()
            torch.testing.assert_close(parameter.detach() - before, torch.full((100, 3), rate))

    def test_state_is_all_there_is(self):
        """Continued in a new optimiser from its state alone, the steps are the same bits, and so is the scale."""
        gradients = [torch.tensor(noise(50, 3, seed=seed), dtype=torch.float32) for seed in range(6)]

        def run(optimiser, parameter, some):
            for gradient in some:
                parameter.grad = gradient.clone()
                optimiser.step()

        whole = torch.zeros(50, 3, requires_grad=True)
        first = UniformAdam([whole], 0.1)
        run(first, whole, gradients[:3])
        parts, state = whole.detach().clone().requires_grad_(), copy.deepcopy(first.state_dict())
        run(first, whole, gradients[3:])
        second = UniformAdam([parts], 0.1)
        assert second.scale == 0
        second.load_state_dict(state)
        assert second.scale > 0
        run(second, parts, gradients[3:])
        assert torch.equal(parts, whole) and second.scale == first.scale

    def test_one_scale_keeps_proportions(self):
        """Plain Adam would move all vertices alike."""
        parameter = torch.zeros(1000, 1, requires_grad=True)
        parameter.grad = torch.linspace(0.1, 1, 1000)[:, None]
        UniformAdam([parameter], 1.0).step()
        assert (parameter[-1] / parameter[0]).item() == pytest.approx(10, rel=1e-4)

    def test_a_spike_neither_jumps_nor_slows_the_others(self):
        quiet, spiky = (torch.zeros(1000, 1, requires_grad=True) for _ in range(2))
        quiet.grad = torch.ones(1000, 1)
        spiky.grad = torch.ones(1000, 1)
        spiky.grad[500] = 1e6
        UniformAdam([quiet], 0.1).step()
        UniformAdam([spiky], 0.1).step()
        torch.testing.assert_close(spiky[:500], quiet[:500])
        assert spiky[500].abs() < 1.01

    def test_not_a_number_moves_nothing(self):
        parameter = torch.zeros(100, 1, requires_grad=True)
        parameter.grad = torch.ones(100, 1)
        parameter.grad[3], parameter.grad[4] = torch.nan, torch.inf
        adam = UniformAdam([parameter], 0.1)
        adam.step()
        assert adam.nonfinite == 2
        assert parameter[3] == parameter[4] == 0
        assert parameter.detach()[5] == pytest.approx(-0.1)

    def test_floor(self):
        """A gradient of a hundredth of the floor moves by about a hundredth of the rate."""
        parameter = torch.zeros(100, 1, requires_grad=True)
        parameter.grad = torch.full((100, 1), 1e-4)
        UniformAdam([parameter], 0.1, floor=1e-2).step()
        torch.testing.assert_close(parameter.detach(), torch.full((100, 1), -0.1 / 101))

    def test_no_gradient_no_step(self):
        parameter = torch.zeros(100, 1, requires_grad=True)
        parameter.grad = torch.zeros(100, 1)
        UniformAdam([parameter], 0.1).step()
        assert (parameter == 0).all()

    def test_does_not_load_the_compiler_of_torch(self):
        code = """
import sys, torch
from genmf_mi.geometry.uniform_adam import UniformAdam
x = torch.ones(9, requires_grad=True)
adam = UniformAdam([x], 0.1)
x.sum().backward()
adam.step()
assert "torch._dynamo" not in sys.modules
"""
        subprocess.run([sys.executable, "-c", code], check=True)

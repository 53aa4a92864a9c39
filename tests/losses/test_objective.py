"""The weighted sum of all terms."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from loss_images import disc, smooth, unit

from genmf_mi.core.config import Weights
from genmf_mi.losses import appearance, geometry, objective
from genmf_mi.losses.alignment import Alignment
from genmf_mi.render.bridge import Buffers

OF_THE_GEOMETRY = {"sdf_tv", "l_dev", "flexi_weight_reg"}
"""Terms of a field on a grid, whatever is rendered."""
ROOM = Alignment("room", 0.9)
OF_THE_STRESS = {"stress_mean", "stress_variance", "stress_band", "stress_peak"}


def buffers(seed: int, size: int = 96, thin: bool = False) -> Buffers:
    """What a disc, or a thin upright plate seen edge-on, may look like."""
    if thin:
        mask = torch.zeros(1, 1, size, size)
        mask[..., size // 8 : -size // 8, size // 2 - 2 : size // 2 + 2] = 1
    else:
        mask = torch.tensor(disc(size)).float()
    grey, depth = (torch.tensor(smooth((1, 1, size, size), seed + i)).float() * mask for i in range(2))
    normal = torch.tensor(unit(smooth((1, 3, size, size), seed + 2) - 0.5)).float() * mask
    return Buffers(grey, depth, normal, mask)


@pytest.mark.usefixtures("lpips_weights")
class TestObjective:
    every = Weights(**{name: 1.0 + i for i, name in enumerate(Weights.__dataclass_fields__)})

    def test_terms_are_the_functions_of_that_name(self):
        part, reference = buffers(0), buffers(10)
        values = objective.terms(part, reference, self.every, ROOM)
        assert set(values) == set(Weights.__dataclass_fields__) - OF_THE_GEOMETRY - OF_THE_STRESS
        mask = reference.coverage
        images = ROOM(part.grey, part.coverage, reference.grey, mask)
        expected = {
            "grey_l1": appearance.grey_l1(*images, mask),
            "ssim": appearance.ssim_loss(*images, mask),
            "gradient": appearance.gradient_match(*images, mask),
            "gradient_ssim": appearance.gradient_ssim_loss(*images, mask),
            "gradient_sign": appearance.gradient_sign_penalty(*images, mask),
            "depth_smoothness": geometry.depth_smoothness(part.depth, mask),
            "normal_smoothness": geometry.normal_smoothness(part.normal, mask),
            "teacher_depth": geometry.teacher_depth(part.depth, reference.depth, mask),
            "teacher_normal": geometry.teacher_normal(part.normal, reference.normal, mask),
            "normal_flip": geometry.normal_flip_penalty(part.normal, reference.normal, mask),
        }
        # The frame is cut to the object, which shifts the pixels of the half-size image by up to one
        loose = {"gradient": 0.1}
        for name, value in expected.items():
            assert values[name].item() == pytest.approx(value.item(), rel=loose.get(name, 1e-4)), name
        assert values["grey_lpips"] > 0.01

    def test_terms_of_the_geometry(self):
        """Those with a weight are kept as they are."""
        terms = dict.fromkeys(OF_THE_GEOMETRY, torch.tensor(2.0))
        assert objective.with_weight(terms, self.every) == terms
        assert set(objective.with_weight(terms, replace(self.every, l_dev=0.0))) == OF_THE_GEOMETRY - {"l_dev"}

    def test_weighted_sum(self):
        values = objective.terms(buffers(0), buffers(10), self.every, ROOM)
        expected = sum(getattr(self.every, name) * value.item() for name, value in values.items())
        assert objective.weighted_sum(values, vars(self.every)).item() == pytest.approx(expected, rel=1e-5)

    def test_no_weight_no_term(self):
        weights = Weights(**dict.fromkeys(Weights.__dataclass_fields__, 0.0) | {"gradient_sign": 2.0})
        assert set(objective.terms(buffers(0), buffers(10), weights, ROOM)) == {"gradient_sign"}

    def test_without_geometry_buffers_only_the_appearance(self):
        part = Buffers(buffers(0).grey, None, None, None)
        assert set(objective.terms(part, buffers(10), self.every, ROOM)) == {
            "grey_l1",
            "grey_lpips",
            "ssim",
            "gradient_ssim",
            "gradient",
            "gradient_sign",
        }

    def test_gradient_reaches_every_buffer(self):
        part, reference = buffers(0), buffers(10)
        for image in (part.grey, part.depth, part.normal):
            image.requires_grad_()
        objective.weighted_sum(objective.terms(part, reference, self.every, ROOM), vars(self.every)).backward()
        for image in (part.grey, part.depth, part.normal):
            assert image.grad.isfinite().all() and image.grad.abs().max() > 0

    def test_a_plate_seen_edge_on(self):
        """What is left of the frame must still be large enough for the network."""
        part, reference = buffers(0, 64, thin=True), buffers(10, 64, thin=True)
        values = objective.terms(part, reference, self.every, ROOM)
        assert all(value.isfinite() for value in values.values())

    def test_an_empty_frame(self):
        empty = Buffers(*(torch.zeros(1, channels, 64, 64) for channels in (1, 1, 3, 1)))
        assert all(value.isfinite() for value in objective.terms(empty, empty, self.every, ROOM).values())

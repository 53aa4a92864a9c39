"""What counts of an image, in values and in gradients."""

from __future__ import annotations

import pytest
import torch

from genmf_mi.core.config import Weights
from genmf_mi.losses import objective
from genmf_mi.losses.alignment import Alignment
from genmf_mi.losses.emphasis import Emphasis
from genmf_mi.render.bridge import Buffers


@pytest.fixture
def images():
    generator = torch.Generator().manual_seed(0)
    image, reference = (torch.rand(1, 1, 8, 8, generator=generator) for _ in range(2))
    return image, reference


def emphasis(wanted: float = 1.0, weight: float = 1.0) -> Emphasis:
    return Emphasis(torch.full((1, 1, 8, 8), wanted), torch.full((1, 1, 8, 8), weight))


def gradient(image, reference, how) -> tuple[float, torch.Tensor]:
    image = image.clone().requires_grad_()
    loss = (how(image, reference) - reference).square().sum()
    loss.backward()
    return loss.item(), image.grad


def test_where_nothing_is_wanted_the_reference_is_seen(images):
    image, reference = images
    torch.testing.assert_close(emphasis(wanted=0.0)(image, reference), reference)
    loss, slope = gradient(image, reference, emphasis(wanted=0.0))
    assert loss == pytest.approx(0, abs=1e-12) and float(slope.abs().max()) == 0


def test_all_of_it_is_the_image(images):
    torch.testing.assert_close(emphasis()(*images), images[0])


def test_the_gradient_of_what_is_wanted_in_part(images):
    """Against finite differences, without a weight."""
    image, reference = (x.double() for x in images)
    how = Emphasis(torch.rand(1, 1, 8, 8).double(), torch.ones(1, 1, 8, 8).double())
    assert torch.autograd.gradcheck(lambda x: (how(x, reference) - reference).square(), image.requires_grad_())


def test_a_weight_scales_the_gradient_and_not_the_loss(images):
    (loss, slope), (weighted_loss, weighted) = (gradient(*images, emphasis(weight=w)) for w in (1.0, 3.0))
    assert weighted_loss == pytest.approx(loss)
    torch.testing.assert_close(weighted, 3 * slope)


def test_terms_of_the_objective_do_not_see_what_is_not_wanted():
    """The left half differs from the reference in any way, and no term says so."""
    generator = torch.Generator().manual_seed(1)
    n, weights = 64, Weights(grey_lpips=0.0, teacher_depth=0.0, teacher_normal=0.0, normal_flip=0.0,
                             normal_smoothness=0.0)  # fmt: skip
    mask, flat = torch.ones(1, 1, n, n), torch.ones(1, 1, n, n)
    reference = Buffers(torch.rand(1, 1, n, n, generator=generator), mask, torch.ones(1, 3, n, n), mask)
    grey = reference.grey.clone()
    grey[..., : n // 2] = torch.rand(1, 1, n, n // 2, generator=generator)
    part = Buffers(grey, mask, torch.ones(1, 3, n, n), mask)
    flat[..., : n // 2] = 0
    free = objective.terms(part, reference, weights, Alignment())
    masked = objective.terms(part, reference, weights, Alignment(), emphasis=Emphasis(flat, torch.ones_like(flat)))
    assert set(free) == {"grey_l1", "ssim", "gradient_ssim", "gradient", "gradient_sign"} == set(masked)
    for name in set(free) - {"gradient_sign"}:
        assert float(free[name]) > 0.05 and float(masked[name]) < 1e-3, name

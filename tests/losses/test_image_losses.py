"""Every loss on images: against a slow NumPy oracle, its gradient against finite differences, what it must ignore."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from loss_images import (
    DEPTH,
    GREY,
    MASK,
    NORMAL,
    REFERENCE,
    SIZE,
    TEACHER_DEPTH,
    TEACHER_NORMAL,
    eroded,
    gradients,
    mean_inside,
    tensors,
)
from scipy import ndimage
from skimage.metrics import structural_similarity

from genmf_mi.losses import appearance, geometry


def oracle_gradient_match(a, b, mask):
    def at_scale(a, b, mask):
        (ax, ay), (bx, by), inside = gradients(a), gradients(b), eroded(mask)
        magnitude = np.abs(np.hypot(ax, ay) - np.hypot(bx, by))
        cosine = (ax * bx + ay * by) / np.sqrt((ax**2 + ay**2 + 1e-6) * (bx**2 + by**2 + 1e-6))
        return mean_inside(magnitude, inside) + 0.5 * mean_inside(1 - cosine**2, inside)

    def halved(x):
        return (x[..., ::2, ::2] + x[..., 1::2, ::2] + x[..., ::2, 1::2] + x[..., 1::2, 1::2]) / 4

    return 0.6 * at_scale(a, b, mask) + 0.4 * at_scale(halved(a), halved(b), halved(mask))


def oracle_gradient_sign(a, b, mask):
    (ax, ay), (bx, by), inside = gradients(a), gradients(b), eroded(mask)
    cosine = (ax * bx + ay * by) / np.sqrt((ax**2 + ay**2 + 1e-6) * (bx**2 + by**2 + 1e-6))
    strength = np.hypot(bx, by)
    return mean_inside(np.maximum(-cosine, 0) * strength, inside) / mean_inside(strength, inside)


def oracle_ssim(a, b, mask):
    maps = [structural_similarity(x[0], y[0], data_range=1.0, full=True)[1] for x, y in zip(a, b, strict=True)]
    return 1 - mean_inside(np.stack(maps)[:, None], mask)


def high_frequency_curvature(image):
    """∂²/∂x² and ∂²/∂y² of what a binomial blur over five pixels takes away."""
    kernel = np.array([1, 4, 6, 4, 1]) / 16
    blurred = image
    for axis in (2, 3):
        blurred = ndimage.convolve1d(blurred, kernel, axis=axis, mode="nearest")
    return [ndimage.convolve1d(image - blurred, [1, -2, 1], axis=axis, mode="constant") for axis in (3, 2)]


def oracle_depth_smoothness(depth, mask):
    xx, yy = high_frequency_curvature(depth)
    return mean_inside(np.abs(xx) + np.abs(yy), eroded(mask, 3))


def oracle_normal_smoothness(normal, mask):
    xx, yy = high_frequency_curvature(normal)
    return mean_inside(np.sqrt((xx**2 + yy**2).sum(axis=1, keepdims=True)), eroded(mask, 3))


def cosine(a, b):
    return ((a * b).sum(axis=1) / np.linalg.norm(a, axis=1) / np.linalg.norm(b, axis=1))[:, None]


# Name: the term, what it takes besides the mask, and its oracle
TERMS = {
    "grey_l1": (appearance.grey_l1, (GREY, REFERENCE),
                lambda a, b, m: mean_inside(np.sqrt((a - b) ** 2 + 1e-6) - 1e-3, m)),
    "ssim": (appearance.ssim_loss, (GREY, REFERENCE), oracle_ssim),
    "gradient_match": (appearance.gradient_match, (GREY, REFERENCE), oracle_gradient_match),
    "gradient_sign": (appearance.gradient_sign_penalty, (GREY, REFERENCE), oracle_gradient_sign),
    "depth_smoothness": (geometry.depth_smoothness, (DEPTH,), oracle_depth_smoothness),
    "normal_smoothness": (geometry.normal_smoothness, (NORMAL,), oracle_normal_smoothness),
    "teacher_depth": (geometry.teacher_depth, (DEPTH, TEACHER_DEPTH),
                      lambda a, b, m: mean_inside(np.abs(a - b), eroded(m))),
    "teacher_normal": (geometry.teacher_normal, (NORMAL, TEACHER_NORMAL),
                       lambda a, b, m: 1 - mean_inside(np.abs(cosine(a, b)), eroded(m))),
    "normal_flip": (geometry.normal_flip_penalty, (NORMAL, TEACHER_NORMAL),
                    lambda a, b, m: mean_inside(np.maximum(-cosine(a, b), 0), eroded(m))),
}  # fmt: skip


@pytest.mark.parametrize("name", TERMS)
class TestEveryTerm:
    def test_value(self, name):
        term, images, oracle = TERMS[name]
        expected = oracle(*images, MASK)
        assert expected > 0.005
        assert term(*tensors(*images, MASK)).item() == pytest.approx(expected, rel=1e-4)

    def test_gradient(self, name):
        """Along random directions, so that every pixel counts."""
        term, images, _ = TERMS[name]
        image, *others, mask = tensors(*images, MASK)
        image.requires_grad_()
        (gradient,) = torch.autograd.grad(term(image, *others, mask), image)
        for seed in range(3):
            direction = torch.randn(image.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))
            step = 1e-7 * direction
            with torch.no_grad():
                difference = (term(image + step, *others, mask) - term(image - step, *others, mask)).item() / 2e-7
            assert (gradient * direction).sum().item() == pytest.approx(difference, rel=1e-4)

    def test_images_of_a_batch_count_alike(self, name):
        """Though the second disc is smaller."""
        term, images, _ = TERMS[name]
        together = term(*tensors(*images, MASK))
        apart = [term(*tensors(*(x[i : i + 1] for x in images), MASK[i : i + 1])) for i in range(2)]
        if name == "gradient_sign":  # a ratio of means over the batch
            assert min(apart) < together < max(apart)
        else:
            assert together.item() == pytest.approx(sum(apart).item() / 2, rel=1e-9)

    def test_blind_outside_of_the_mask(self, name):
        """The windows of 1 − SSIM reach 3 pixels beyond, all others stay inside."""
        term, images, _ = TERMS[name]
        reach = 3 if name == "ssim" else 0
        window = np.ones((2 * reach + 1,) * 2)
        outside = ~np.stack([ndimage.binary_dilation(m[0] > 0, window) for m in MASK])[:, None]
        others = [np.where(outside, 0.9 * x.max() - x, x) for x in images]
        assert term(*tensors(*others, MASK)).item() == pytest.approx(term(*tensors(*images, MASK)).item(), rel=1e-9)

    def test_finite_where_nothing_is(self, name):
        """Flat images, normals of no length, an empty mask: no NaN may reach the vertices."""
        term, images, _ = TERMS[name]
        flat = [torch.zeros(x.shape) for x in images]
        for mask in (torch.tensor(MASK).float(), torch.zeros(MASK.shape)):
            image = flat[0].clone().requires_grad_()
            value = term(image, *flat[1:], mask)
            value.backward()
            assert value.isfinite() and image.grad.isfinite().all()

    def test_zero_at_its_goal(self, name):
        """At the reference itself; the smoothness terms on a plane that is seen at a slant."""
        term, images, _ = TERMS[name]
        if "smoothness" in name:
            ramp = np.linspace(0, 1, SIZE) + np.linspace(0, 0.3, SIZE)[:, None]
            images = [np.broadcast_to(ramp, images[0].shape).copy()]
        else:
            images = [images[1], images[1]]
        assert term(*tensors(*images, MASK)).item() == pytest.approx(0, abs=2e-3 if name == "gradient_match" else 1e-6)

"""The alignment of grey images, and what single terms of the appearance give on images made for them."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from jaxtyping import TypeCheckError
from loss_images import GREY, MASK, NORMAL, REFERENCE, SIZE, TEACHER_NORMAL, disc, eroded, gradients, tensors
from skimage.metrics import structural_similarity

from genmf_mi.core.colour import to_srgb
from genmf_mi.losses import appearance, geometry


def oracle_align(grey, reference, mask):
    out = np.zeros_like(grey)
    for i, (g, r, m) in enumerate(zip(grey, reference, mask, strict=True)):

        def moments(x, m=m):
            mean = (x * m).sum() / m.sum()
            return mean, np.sqrt((m * (x - mean) ** 2).sum() / m.sum())

        (mean, deviation), (wanted_mean, wanted_deviation) = moments(g), moments(r)
        out[i] = ((g - mean) / deviation * wanted_deviation + wanted_mean) * m
    return out


class TestAlign:
    def test_value(self):
        aligned = appearance.align(*tensors(GREY, REFERENCE, MASK))
        np.testing.assert_allclose(aligned, oracle_align(GREY, REFERENCE, MASK), atol=1e-9)

    @pytest.mark.parametrize(("gain", "offset"), [(0.3, 0.4), (5.0, -1.0)])
    def test_exposure_and_contrast_cost_nothing(self, gain, offset):
        grey, reference, mask = tensors(GREY, REFERENCE, MASK)
        aligned, again = (appearance.align(x, reference, mask) for x in (grey, gain * grey + offset))
        torch.testing.assert_close(again, aligned, rtol=0, atol=1e-9)

    def test_a_negative_is_no_gain(self):
        """Contrast may be stretched but not turned over."""
        reference, mask = tensors(REFERENCE, MASK)
        turned = appearance.align(1 - reference, reference, mask)
        assert appearance.grey_l1(turned, reference, mask) > 0.1
        torch.testing.assert_close(appearance.align(reference, reference, mask), reference * mask)
        assert (turned[mask == 0] == 0).all()

    def test_gradient(self):
        grey, reference, mask = tensors(GREY[:1, :, 8:16, 8:16], REFERENCE[:1, :, 8:16, 8:16], MASK[:1, :, 8:16, 8:16])
        assert torch.autograd.gradcheck(lambda x: appearance.align(x, reference, mask), grey.requires_grad_())

    def test_an_image_of_one_value_stays_quiet(self):
        """Its deviation is round-off, which must not be blown up to the reference's contrast."""
        _, reference, mask = (x.float() for x in tensors(GREY, REFERENCE, MASK))
        flat = torch.full_like(reference, 0.3)
        spread = (appearance.align(flat, reference, mask) - reference.mean() * mask)[mask == 1].std()
        assert spread < 0.2 * reference.std()


class TestAlignSrgb:
    """Both images are brought to equal exposure in linear light, sRGB-encoded and aligned."""

    rim = MASK * 0.9 + 0.1 * disc(SIZE, 2) ** 2

    def test_against_numpy(self):
        grey, reference = GREY * self.rim, REFERENCE * MASK
        seen, target = appearance.align_srgb(*tensors(grey, self.rim, reference, MASK))
        own, wanted = grey / np.maximum(self.rim, 1e-3), reference / np.maximum(MASK, 1e-3)
        exposure = (wanted * MASK).sum(axis=(2, 3), keepdims=True) / (own * MASK).sum(axis=(2, 3), keepdims=True)
        encoded = to_srgb(wanted).astype(np.float64)
        np.testing.assert_allclose(target, encoded * MASK, atol=1e-6)
        np.testing.assert_allclose(seen, oracle_align(to_srgb(np.maximum(own, 0) * exposure), encoded, MASK), atol=1e-5)

    def test_encoding(self):
        linear = torch.linspace(-0.1, 1.2, 500, dtype=torch.float64, requires_grad=True)
        encoded = to_srgb(linear)
        np.testing.assert_allclose(encoded.detach(), to_srgb(np.maximum(linear.detach().numpy(), 0)), atol=1e-6)
        encoded.sum().backward()
        assert linear.grad.isfinite().all() and (linear.grad[linear > 0] > 0).all()

    def test_exposure_costs_nothing(self):
        """Twice the light, or half, in linear light: the encoding is no straight line."""
        grey, mask, reference = tensors(GREY * MASK, MASK, REFERENCE * MASK)
        plain, _ = appearance.align_srgb(grey, mask, reference, mask)
        for gain in (0.25, 1.7):
            torch.testing.assert_close(appearance.align_srgb(gain * grey, mask, reference, mask)[0], plain)

    def test_itself(self):
        reference, mask = tensors(REFERENCE * MASK, MASK)
        seen, target = appearance.align_srgb(0.3 * reference, mask, reference, mask)
        torch.testing.assert_close(seen, target, rtol=0, atol=1e-6)

    def test_black_or_empty(self):
        """An object without light, a part that left the frame, nothing at all: no NaN."""
        reference, mask = tensors(REFERENCE * MASK, MASK)
        nothing = torch.zeros_like(mask)
        black, gone = (nothing, mask, reference, mask), (nothing, nothing, reference, mask)
        for images in (black, gone, (reference, mask, nothing, mask), (nothing, nothing, nothing, nothing)):
            part = images[0].clone().requires_grad_()
            seen, target = appearance.align_srgb(part, *images[1:])
            seen.square().sum().backward()
            assert seen.isfinite().all() and target.isfinite().all() and part.grad.isfinite().all()

    def test_gradient(self):
        window = np.s_[:1, :, 8:16, 8:16]
        grey, mask, reference = tensors(GREY[window], MASK[window], REFERENCE[window])
        grey.requires_grad_()
        assert torch.autograd.gradcheck(lambda x: appearance.align_srgb(x, mask, reference, mask)[0], grey)


def test_ssim_loss_is_one_minus_ssim_inside():
    """Pixel by pixel: masks of one pixel each, three or more away from the border, where windows are cut."""
    a, b = GREY[:1], REFERENCE[:1]
    _, similarity = structural_similarity(a[0, 0], b[0, 0], data_range=1.0, full=True)
    for row, column in ((3, 3), (14, 9), (SIZE - 4, SIZE - 4)):
        mask = np.zeros((1, 1, SIZE, SIZE))
        mask[0, 0, row, column] = 1
        assert appearance.ssim_loss(*tensors(a, b, mask)).item() == pytest.approx(1 - similarity[row, column], abs=1e-9)


def test_gradient_magnitude():
    """A step from 0 to 1 counts as 1."""
    step = np.zeros((1, 1, 9, 12))
    step[..., 6:] = 1
    seen = appearance.gradient_magnitude(torch.tensor(step))[0, 0, 1:-1]
    np.testing.assert_allclose(seen[:, 5:7], 1, atol=1e-5)
    np.testing.assert_allclose(seen[:, 1:5], 0, atol=1e-5)
    x, y = gradients(GREY)
    seen = appearance.gradient_magnitude(torch.tensor(GREY))
    np.testing.assert_allclose(seen, np.minimum(2 * np.hypot(x, y), 1), atol=1e-5)


def test_interior_and_blur():
    np.testing.assert_array_equal(appearance.interior(torch.tensor(MASK), 2), eroded(MASK, 2))
    impulse = np.zeros((1, 2, 9, 9))
    impulse[0, 1, 4, 4] = 1
    kernel = np.array([1, 4, 6, 4, 1]) / 16
    blurred = geometry.blur(torch.tensor(impulse))[0]
    np.testing.assert_allclose(blurred[1, 2:7, 2:7], np.outer(kernel, kernel), atol=1e-12)
    assert blurred[0].abs().max() == 0
    constant = torch.full((1, 3, 6, 7), 0.7)
    torch.testing.assert_close(geometry.blur(constant), constant)


class TestBlindTerms:
    """The paper's terms that are blind to a sign, and the guards beside them that are not."""

    line = 0.5 + 0.3 * np.exp(-((np.arange(SIZE) - 13.3) ** 2) / 4) * np.ones((1, 1, SIZE, 1))
    mask = np.pad(np.ones((1, 1, SIZE - 4, SIZE - 4)), ((0, 0), (0, 0), (2, 2), (2, 2)))

    def test_dark_line_for_a_bright_one(self):
        bright, mask = tensors(self.line, self.mask)
        dark = 1 - bright
        assert appearance.gradient_match(dark, bright, mask) == pytest.approx(
            appearance.gradient_match(bright, bright, mask).item(), abs=1e-9
        )
        assert appearance.gradient_sign_penalty(bright, bright, mask) == 0
        assert appearance.gradient_sign_penalty(dark, bright, mask) > 0.9

    def test_sign_penalty_pushes_the_right_way(self):
        """From nothing visible, a step against the gradient of the guard brightens the line."""
        bright, mask = tensors(self.line, self.mask)
        flat = (0.5 - 0.01 * (bright - 0.5)).requires_grad_()
        appearance.gradient_sign_penalty(flat, bright, mask).backward()
        assert (flat.grad * (bright - 0.5)).sum() < 0

    def test_flipped_normals(self):
        normal, mask = tensors(NORMAL, MASK)
        assert geometry.teacher_normal(-normal, normal, mask).item() == pytest.approx(0, abs=1e-9)
        assert geometry.normal_flip_penalty(normal, normal, mask) == 0
        assert geometry.normal_flip_penalty(-normal, normal, mask).item() == pytest.approx(1)

    def test_length_of_normals_does_not_matter(self):
        """Averages over a pixel are shorter than one."""
        normal, teacher, mask = tensors(NORMAL, TEACHER_NORMAL, MASK)
        for term in (geometry.teacher_normal, geometry.normal_flip_penalty):
            torch.testing.assert_close(term(0.7 * normal, teacher, mask), term(normal, teacher, mask))


def test_wrong_shapes_are_refused():
    """Under the checks that conftest.py switches on: another size, RGB for grey, and integers."""
    grey, reference, mask = tensors(GREY, REFERENCE, MASK)
    for bad in (mask[..., 1:], mask.expand(-1, 3, -1, -1), mask.bool(), mask[0]):
        with pytest.raises(TypeCheckError):
            appearance.grey_l1(grey, reference, bad)

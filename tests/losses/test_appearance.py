"""What single terms of the appearance give on images made for them."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from jaxtyping import TypeCheckError
from loss_images import GREY, MASK, NORMAL, REFERENCE, SIZE, TEACHER_NORMAL, eroded, gradients, tensors
from skimage.metrics import structural_similarity

from genmf_mi.losses import appearance, geometry


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

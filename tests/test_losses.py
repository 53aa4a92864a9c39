"""Every term against a slow NumPy oracle, its gradient against finite differences, and what it must not see."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy import ndimage
from skimage.metrics import structural_similarity

from genmf_mi.core.colour import to_srgb
from genmf_mi.core.config import Weights
from genmf_mi.losses import appearance, geometry, objective
from genmf_mi.render.bridge import Buffers

OF_THE_GEOMETRY = {"sdf_tv", "l_dev", "flexi_weight_reg"}
"""Terms that a field on a grid tells of itself, whatever is rendered."""


def smooth(shape: tuple[int, ...], seed: int, sigma: float = 1.5) -> np.ndarray:
    """Random images in 0..1 with some structure."""
    noise = np.random.default_rng(seed).standard_normal(shape)
    image = ndimage.gaussian_filter(noise, (*[0] * (len(shape) - 2), sigma, sigma))
    return 0.5 + 0.2 * image / image.std()


def disc(size: int, count: int = 1) -> np.ndarray:
    """Antialiased masks ``[B,1,H,W]`` of discs of different sizes."""
    y, x = np.mgrid[:size, :size] - (size - 1) / 2
    return np.stack([np.clip(size * (0.37 - 0.05 * i) - np.hypot(x - i, y), 0, 1)[None] for i in range(count)])


def unit(normals: np.ndarray) -> np.ndarray:
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


SIZE = 28
MASK = disc(SIZE, 2)
GREY, REFERENCE = smooth((2, 1, SIZE, SIZE), 0), smooth((2, 1, SIZE, SIZE), 1)
DEPTH, TEACHER_DEPTH = smooth((2, 1, SIZE, SIZE), 2), smooth((2, 1, SIZE, SIZE), 3)
NORMAL = unit(smooth((2, 3, SIZE, SIZE), 4) - 0.5)
TEACHER_NORMAL = unit(smooth((2, 3, SIZE, SIZE), 5) - 0.5)


def mean_inside(image: np.ndarray, mask: np.ndarray) -> float:
    """Mean of ``[B,C,H,W]`` weighted by ``[B,1,H,W]``, image by image, channel by channel."""
    means = [np.average(channel, weights=m[0]) for x, m in zip(image, mask, strict=True) for channel in x]
    return float(np.mean(means))


def gradients(image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sobel derivatives ``[B,1,H,W]`` along x and y, zeros beyond the border."""
    x = np.stack([ndimage.sobel(i[0], axis=1, mode="constant") / 8 for i in image])[:, None]
    y = np.stack([ndimage.sobel(i[0], axis=0, mode="constant") / 8 for i in image])[:, None]
    return x, y


def eroded(mask: np.ndarray, pixels: int = 1) -> np.ndarray:
    window = np.ones((2 * pixels + 1,) * 2)
    return np.stack([ndimage.binary_erosion(m[0] > 0.999, window, border_value=1) for m in mask])[:, None].astype(float)


def oracle_align(grey, reference, mask):
    out = np.zeros_like(grey)
    for i, (g, r, m) in enumerate(zip(grey, reference, mask, strict=True)):

        def moments(x, m=m):
            mean = (x * m).sum() / m.sum()
            return mean, np.sqrt((m * (x - mean) ** 2).sum() / m.sum())

        (mean, deviation), (wanted_mean, wanted_deviation) = moments(g), moments(r)
        out[i] = ((g - mean) / deviation * wanted_deviation + wanted_mean) * m
    return out


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


def tensors(*arrays: np.ndarray) -> list[torch.Tensor]:
    return [torch.tensor(array) for array in arrays]


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


class TestOnScreen:
    """Both images as a screen shows them: equal exposure in linear light, encoded, aligned."""

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
        encoded = appearance.encode(linear)
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


def test_structure_is_one_minus_ssim_inside():
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


class TestWhatAFormulaCannotSee:
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

    def test_polarity_pushes_the_right_way(self):
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
        values = objective.terms(part, reference, self.every)
        assert set(values) == set(Weights.__dataclass_fields__) - OF_THE_GEOMETRY
        mask = reference.coverage
        images = appearance.align_srgb(part.grey, part.coverage, reference.grey, mask)
        expected = {
            "grey_l1": appearance.grey_l1(*images, mask),
            "ssim": appearance.ssim_loss(*images, mask),
            "gradient": appearance.gradient_match(*images, mask),
            "gradient_ssim": appearance.ssim_loss(*map(appearance.gradient_magnitude, images), mask),
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
        told = dict.fromkeys(OF_THE_GEOMETRY, torch.tensor(2.0))
        assert objective.weighted(told, self.every) == told
        assert set(objective.weighted(told, replace(self.every, l_dev=0.0))) == OF_THE_GEOMETRY - {"l_dev"}

    def test_total(self):
        values = objective.terms(buffers(0), buffers(10), self.every)
        expected = sum(getattr(self.every, name) * value.item() for name, value in values.items())
        assert objective.total(values, self.every).item() == pytest.approx(expected, rel=1e-5)

    def test_no_weight_no_term(self):
        weights = Weights(**dict.fromkeys(Weights.__dataclass_fields__, 0.0) | {"gradient_sign": 2.0})
        assert set(objective.terms(buffers(0), buffers(10), weights)) == {"gradient_sign"}

    def test_without_geometry_buffers_only_the_appearance(self):
        part = Buffers(buffers(0).grey, None, None, None)
        assert set(objective.terms(part, buffers(10), self.every)) == {
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
        objective.total(objective.terms(part, reference, self.every), self.every).backward()
        for image in (part.grey, part.depth, part.normal):
            assert image.grad.isfinite().all() and image.grad.abs().max() > 0

    def test_a_plate_seen_edge_on(self):
        """What is left of the frame must still be large enough for the network."""
        part, reference = buffers(0, 64, thin=True), buffers(10, 64, thin=True)
        values = objective.terms(part, reference, self.every)
        assert all(value.isfinite() for value in values.values())

    def test_an_empty_frame(self):
        empty = Buffers(*(torch.zeros(1, channels, 64, 64) for channels in (1, 1, 3, 1)))
        assert all(value.isfinite() for value in objective.terms(empty, empty, self.every).values())

"""How a render is fitted to its reference before the two are compared."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from loss_images import GREY, MASK, REFERENCE, SIZE, disc, smooth, tensors

from genmf_mi.core.colour import to_srgb
from genmf_mi.losses import alignment as alignments
from genmf_mi.losses import appearance
from genmf_mi.losses.alignment import Alignment, align_moments, align_robustly


def oracle_moments(grey, reference, mask):
    out = np.zeros_like(grey)
    for i, (g, r, m) in enumerate(zip(grey, reference, mask, strict=True)):

        def moments(x, m=m):
            mean = (x * m).sum() / m.sum()
            return mean, np.sqrt((m * (x - mean) ** 2).sum() / m.sum())

        (mean, deviation), (wanted_mean, wanted_deviation) = moments(g), moments(r)
        out[i] = ((g - mean) / deviation * wanted_deviation + wanted_mean) * m
    return out


def oracle_robust(grey, reference, mask):
    """Iteratively reweighted least squares, line by line as in a textbook."""
    out = np.zeros_like(grey)
    for i in range(len(grey)):
        x, y, m = (image[i].ravel() for image in (grey, reference, mask))

        def fit(weight, x=x, y=y):
            x_mean, y_mean = np.average(x, weights=weight), np.average(y, weights=weight)
            gain = np.average((x - x_mean) * (y - y_mean), weights=weight) / np.average(
                (x - x_mean) ** 2, weights=weight
            )
            return y_mean + min(max(gain, 0.5), 2.0) * (x - x_mean)

        weight = m
        for _ in range(alignments.REWEIGHTINGS):
            residual = np.abs(y - fit(weight))
            inside = np.sort(residual[m >= 0.5])
            scale = 1.5 * max(inside[(len(inside) - 1) // 2], 0.01)
            weight = m / (1 + (residual / scale) ** 2)
        out[i] = (fit(weight) * m).reshape(grey[i].shape)
    return out


class TestRobust:
    def test_value(self):
        aligned = align_robustly(*tensors(GREY, REFERENCE, MASK))
        np.testing.assert_allclose(aligned, oracle_robust(GREY, REFERENCE, MASK), atol=1e-5)

    @pytest.mark.parametrize(("gain", "offset"), [(0.6, 0.2), (1.5, -0.3)])
    def test_spots_of_paint_do_not_stretch_the_rest(self, gain, offset):
        """A part that shades as the object does, but for a dark spot on a tenth of it, is fitted by the other nine."""
        shading, mask = tensors(GREY, MASK)
        spots = torch.tensor(smooth(GREY.shape, 7, 3.0))
        painted = torch.where(spots > spots[mask == 1].quantile(0.9), 0.05, shading)
        plain = (painted == shading) & (mask == 1)
        part = (shading - offset) / gain
        robust, stretched = (f(part, painted, mask) for f in (align_robustly, align_moments))
        assert (robust - painted)[plain].abs().max() < 0.01
        assert (stretched - painted)[plain].abs().mean() > 5 * (robust - painted)[plain].abs().mean()

    def test_contrast_is_bounded(self):
        """A part that hardly shades is not made to, and one that shades too deeply is not excused."""
        reference, mask = tensors(REFERENCE, MASK)
        for depth, gain in ((0.1, 2.0), (10.0, 0.5)):
            part = reference.mean() + depth * (reference - reference.mean())
            for one, image, inside in zip(align_robustly(part, reference, mask), part, mask == 1, strict=True):
                assert one[inside].std() == pytest.approx(gain * image[inside].std().item(), rel=1e-6)

    def test_gradient_with_fixed_weights(self, monkeypatch):
        """Without reweighting the fit is a closed form with a gradient; the weights are constants of it."""
        monkeypatch.setattr(alignments, "REWEIGHTINGS", 0)
        window = np.s_[:1, :, 8:16, 8:16]
        grey, reference, mask = tensors(GREY[window], REFERENCE[window], MASK[window])
        near = reference + 0.2 * grey
        assert torch.autograd.gradcheck(lambda x: align_robustly(x, reference, mask), near.requires_grad_())

    def test_what_the_fit_explains_has_no_gradient(self):
        grey, reference, mask = tensors(0.3 * GREY + REFERENCE, REFERENCE, MASK)
        gain = torch.ones((), dtype=grey.dtype, requires_grad=True)
        loss = appearance.grey_l1(align_robustly(gain * grey, reference, mask), reference, mask)
        assert abs(torch.autograd.grad(loss, gain)[0]) < 1e-4


class TestMoments:
    def test_value(self):
        aligned = align_moments(*tensors(GREY, REFERENCE, MASK))
        np.testing.assert_allclose(aligned, oracle_moments(GREY, REFERENCE, MASK), atol=1e-9)

    @pytest.mark.parametrize(("gain", "offset"), [(0.3, 0.4), (5.0, -1.0)])
    def test_exposure_and_contrast_cost_nothing(self, gain, offset):
        grey, reference, mask = tensors(GREY, REFERENCE, MASK)
        aligned, again = (align_moments(x, reference, mask) for x in (grey, gain * grey + offset))
        torch.testing.assert_close(again, aligned, rtol=0, atol=1e-9)

    def test_a_negative_is_no_gain(self):
        """Contrast may be stretched but not turned over."""
        reference, mask = tensors(REFERENCE, MASK)
        turned = align_moments(1 - reference, reference, mask)
        assert appearance.grey_l1(turned, reference, mask) > 0.1
        torch.testing.assert_close(align_moments(reference, reference, mask), reference * mask)
        assert (turned[mask == 0] == 0).all()

    def test_gradient(self):
        grey, reference, mask = tensors(GREY[:1, :, 8:16, 8:16], REFERENCE[:1, :, 8:16, 8:16], MASK[:1, :, 8:16, 8:16])
        assert torch.autograd.gradcheck(lambda x: align_moments(x, reference, mask), grey.requires_grad_())

    def test_an_image_of_one_value_stays_quiet(self):
        """Its deviation is round-off, which must not be blown up to the reference's contrast."""
        _, reference, mask = (x.float() for x in tensors(GREY, REFERENCE, MASK))
        flat = torch.full_like(reference, 0.3)
        spread = (align_moments(flat, reference, mask) - reference.mean() * mask)[mask == 1].std()
        assert spread < 0.2 * reference.std()


def fitted(kind, grey, coverage, reference, mask):
    """Ĝ and G_gt, with the exposure of these images."""
    exposure = Alignment.fit(grey, coverage, reference, mask).exposure
    return Alignment(kind, exposure)(grey, coverage, reference, mask)


@pytest.mark.parametrize("kind", ["room", "robust", "paper"])
class TestAlignment:
    """Both images are sRGB-encoded; the part has no exposure of its own."""

    rim = MASK * 0.9 + 0.1 * disc(SIZE, 2) ** 2

    def test_against_numpy(self, kind):
        grey, reference = GREY * self.rim, REFERENCE * MASK
        seen, target = fitted(kind, *tensors(grey, self.rim, reference, MASK))
        own, wanted = grey / np.maximum(self.rim, 1e-3), reference / np.maximum(MASK, 1e-3)
        encoded = to_srgb(wanted).astype(np.float64)
        np.testing.assert_allclose(target, encoded * MASK, atol=1e-6)
        if kind == "room":
            inside, exposures = MASK > 0.5, np.geomspace(1 / 8, 8, 4000)
            exposure = min(exposures, key=lambda e: np.abs(to_srgb(own[inside] * e) - encoded[inside]).sum())
            expected = to_srgb(own * exposure) * MASK
            np.testing.assert_allclose(seen, expected, atol=2e-3)
            return
        else:
            exposure = (wanted * MASK).sum(axis=(2, 3), keepdims=True) / (own * MASK).sum(axis=(2, 3), keepdims=True)
            oracle = {"robust": oracle_robust, "paper": oracle_moments}[kind]
            expected = oracle(to_srgb(np.maximum(own, 0) * exposure), encoded, MASK)
        np.testing.assert_allclose(seen, expected, atol=1e-5)

    def test_exposure_costs_nothing(self, kind):
        """Twice the light, or half, in linear light: the encoding is no straight line."""
        grey, mask, reference = tensors(GREY * MASK, MASK, REFERENCE * MASK)
        plain, _ = fitted(kind, grey, mask, reference, mask)
        for stops in (-2, 1):
            again, _ = fitted(kind, 2.0**stops * grey, mask, reference, mask)
            torch.testing.assert_close(again, plain, rtol=0, atol=1e-5)

    def test_itself(self, kind):
        reference, mask = tensors(REFERENCE * MASK, MASK)
        seen, target = fitted(kind, reference / 4, mask, reference, mask)
        torch.testing.assert_close(seen, target, rtol=0, atol=1e-3)

    def test_black_or_empty(self, kind):
        """An object without light, a part that left the frame, nothing at all: no NaN."""
        reference, mask = tensors(REFERENCE * MASK, MASK)
        nothing = torch.zeros_like(mask)
        black, gone = (nothing, mask, reference, mask), (nothing, nothing, reference, mask)
        for images in (black, gone, (reference, mask, nothing, mask), (nothing, nothing, nothing, nothing)):
            part = images[0].clone().requires_grad_()
            seen, target = fitted(kind, part, *images[1:])
            seen.square().sum().backward()
            assert seen.isfinite().all() and target.isfinite().all() and part.grad.isfinite().all()


class TestRoom:
    def test_one_exposure_for_all_views(self):
        """A side that is painted dark does not make the part a dark one."""
        reference, mask = tensors(REFERENCE * MASK, MASK)
        dark = reference * torch.tensor([1.0, 0.1])[:, None, None, None]
        alignment = Alignment.fit(*(torch.cat([x, x[:1]]) for x in (reference, mask, dark, mask)))
        assert alignment.exposure == pytest.approx(1.0, rel=0.05)
        seen, _ = alignment(reference, mask, dark, mask)
        np.testing.assert_allclose(seen, to_srgb(REFERENCE) * MASK, atol=0.02)

    def test_gradient(self):
        window = np.s_[:1, :, 8:16, 8:16]
        grey, mask, reference = tensors(GREY[window], MASK[window], REFERENCE[window])
        grey.requires_grad_()
        assert torch.autograd.gradcheck(lambda x: Alignment("room", 0.7)(x, mask, reference, mask)[0], grey)


def test_encoding():
    linear = torch.linspace(-0.1, 1.2, 500, dtype=torch.float64, requires_grad=True)
    encoded = to_srgb(linear)
    np.testing.assert_allclose(encoded.detach(), to_srgb(np.maximum(linear.detach().numpy(), 0)), atol=1e-6)
    encoded.sum().backward()
    assert linear.grad.isfinite().all() and (linear.grad[linear > 0] > 0).all()


def test_gradient_of_the_whole():
    window = np.s_[:1, :, 8:16, 8:16]
    grey, mask, reference = tensors(GREY[window], MASK[window], REFERENCE[window])
    grey.requires_grad_()
    assert torch.autograd.gradcheck(lambda x: Alignment("paper")(x, mask, reference, mask)[0], grey)

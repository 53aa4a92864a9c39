"""How far the rendered grey image of the part is from that of the textured object.

All images are torch tensors ``[B,1,H,W]`` in 0..1, sRGB-encoded (:func:`genmf_mi.core.colour.to_srgb`); masks
``[B,1,H,W]`` in 0..1. Statistics and averages are taken inside the mask, each image of the batch on its own. Functions
return a scalar, the mean over the batch, unless stated otherwise.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from genmf_mi.losses.shapes import GreyImages, Scalar

L1_KNEE = 1e-3
"""Differences well below this weigh quadratically: round-off must not pull with the full force of |x|."""


def masked_mean(x: Float[Tensor, "B C H W"], mask: GreyImages) -> Scalar:
    """Mean of ``x [B,C,H,W]`` inside ``mask [B,1,H,W]``, then over channels and the batch."""
    inside = mask.sum(dim=(2, 3)).clamp_min(1e-6)
    return ((x * mask).sum(dim=(2, 3)) / inside).mean()


def grey_l1(aligned: GreyImages, reference: GreyImages, mask: GreyImages) -> Scalar:
    """L_grayL1: mean absolute difference, rounded off within ``L1_KNEE`` of zero (a Charbonnier penalty)."""
    return masked_mean(((aligned - reference).square() + L1_KNEE**2).sqrt() - L1_KNEE, mask)


def ssim_loss(image: GreyImages, reference: GreyImages, mask: GreyImages) -> Scalar:
    """1 − SSIM inside the mask (Wang et al. 2004), with a uniform 7 × 7 window and data range 1, as in
    scikit-image.

    Not one of GenMF's terms. L1 and LPIPS say little about small ripples on what should be plain; this does.
    """
    window, c1, c2 = 7, 0.01**2, 0.03**2
    unbiased = window**2 / (window**2 - 1)

    def mean(x: Tensor) -> Tensor:
        return F.avg_pool2d(x, window, stride=1, padding=window // 2, count_include_pad=True)

    a, b = mean(image), mean(reference)
    variance_a, variance_b = (unbiased * (mean(x * x) - m * m) for x, m in ((image, a), (reference, b)))
    covariance = unbiased * (mean(image * reference) - a * b)
    similarity = (2 * a * b + c1) * (2 * covariance + c2) / ((a * a + b * b + c1) * (variance_a + variance_b + c2))
    return masked_mean(1 - similarity, mask)


def gradient_ssim_loss(image: GreyImages, reference: GreyImages, mask: GreyImages) -> Scalar:
    """:func:`ssim_loss` of the gradient magnitudes. Not one of GenMF's terms."""
    return ssim_loss(gradient_magnitude(image), gradient_magnitude(reference), mask)


def gradient_magnitude(grey: GreyImages) -> GreyImages:
    """Sobel gradient magnitude of ``[B,1,H,W]``, such that a step from 0 to 1 gives 1, clipped to 0..1."""
    x, y = sobel(grey)
    return (2 * (x.square() + y.square() + 1e-12).sqrt()).clamp(0, 1)


def sobel(x: GreyImages) -> tuple[GreyImages, GreyImages]:
    """Horizontal and vertical Sobel derivatives of ``[B,1,H,W]``, per pixel (kernel sum 8), zero at the border."""
    kernel = torch.tensor([[-1.0, 0.0, 1.0], [-2.0, 0.0, 2.0], [-1.0, 0.0, 1.0]], dtype=x.dtype, device=x.device) / 8
    both = F.conv2d(x, torch.stack([kernel, kernel.T])[:, None], padding=1)
    return both[:, :1], both[:, 1:]


def interior(mask: GreyImages, pixels: int = 1) -> GreyImages:
    """The mask where the object fills whole pixels, eroded by ``pixels``; 0 or 1."""
    full = (mask > 0.999).to(mask.dtype)
    return -F.max_pool2d(-full, 2 * pixels + 1, stride=1, padding=pixels)


def gradient_match(aligned: GreyImages, reference: GreyImages, mask: GreyImages) -> Scalar:
    """L_geo = 0.6 L_full + 0.4 L_half with L = L_mag + 0.5 L_dir on Sobel gradients.

    L_mag is the mean absolute difference of the magnitudes, L_dir one minus the squared cosine between the gradients.
    Gradients of the silhouette are the same in both images and are left out: the mask is eroded by the footprint of the
    kernel.
    """

    def at_scale(a: Tensor, b: Tensor, m: Tensor) -> Tensor:
        m = interior(m)
        magnitude, direction, _ = _gradient_terms(a, b)
        return masked_mean(magnitude, m) + 0.5 * masked_mean(direction, m)

    half = [F.avg_pool2d(x, 2) for x in (aligned, reference, mask)]
    return 0.6 * at_scale(aligned, reference, mask) + 0.4 * at_scale(*half)


def gradient_sign_penalty(aligned: GreyImages, reference: GreyImages, mask: GreyImages) -> Scalar:
    """Guard beside L_dir, which squares the cosine and takes a dark line for a bright one.

    The mean of max(0, −cos) weighted by the reference's gradient magnitude, relative to its mean: zero where light
    and dark change in the same direction.
    """
    inside = interior(mask)
    _, _, opposed = _gradient_terms(aligned, reference)
    x, y = sobel(reference)
    weight = (x.square() + y.square() + 1e-12).sqrt()
    return masked_mean(opposed * weight, inside) / masked_mean(weight, inside).clamp_min(1e-4)


def _gradient_terms(a: GreyImages, b: GreyImages) -> tuple[GreyImages, GreyImages, GreyImages]:
    """Per pixel: | |∇a| − |∇b| |, 1 − cos², max(0, −cos)."""
    # Gradients below this are round-off of a flat region and have no direction: the cosine fades to 0 there
    floor = 1e-3
    (ax, ay), (bx, by) = sobel(a), sobel(b)
    squared_a, squared_b = ax.square() + ay.square(), bx.square() + by.square()
    magnitude = ((squared_a + 1e-10).sqrt() - (squared_b + 1e-10).sqrt()).abs()
    cosine = (ax * bx + ay * by) / ((squared_a + floor**2) * (squared_b + floor**2)).sqrt()
    return magnitude, 1 - cosine.square(), torch.relu(-cosine)

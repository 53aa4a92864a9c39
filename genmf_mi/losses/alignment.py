"""Ĝ and G_gt as they are compared: which differences between two grey images are not the part's fault.

A part has one grey and a room one brightness. Both are unknown and no shape can change them, so renders of the part are
fitted to those of the textured object before they are compared. How freely decides what the comparison rewards:

- ``room`` (the default): one exposure in linear light, the same for all views and for all shapes, at which the part
  before its refinement comes closest to the object. That is how an eye adapts: to the room, not to the picture. The
  contrast of the shading is what a person would see.
- ``robust``: gain and offset per image, by a fit in which paint counts as residual. Where two colours cover about the
  same area, as on the sides of a bus, it takes now the one and now the other for the part.
- ``paper`` (GenMF): mean and variance per image are made equal. Paint raises the variance of the reference, so that the
  shading of a plain grey part is stretched until it varies as much.

Images are torch tensors ``[B,1,H,W]``, weighted by their coverage or mask ``[B,1,H,W]`` in 0..1; statistics are taken
inside the mask, each image of the batch on its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from genmf_mi.core.colour import to_srgb
from genmf_mi.losses.shapes import GreyImages

Kind = Literal["room", "robust", "paper"]

GAIN = 0.5, 2.0
"""Limits of the contrast that the robust fit may give to a part."""
REWEIGHTINGS = 10
TUNING = 1.5
"""Residuals of this many times the median weigh half in the robust fit."""
SMALLEST_MEDIAN = 0.01
"""Of the residuals, encoded: below it everything fits, and round-off must not decide what weighs."""
LARGEST_STOPS, REFINEMENTS = 6.0, 4
"""The exposure of ``room`` is sought within so many powers of 2 either way, and so often about the best one so far."""


@dataclass(frozen=True)
class Alignment:
    """How renders of a part are fitted to those of the textured object.

    exposure: factor on the linear grey values of the part; of ``room``, the others find their own.
    """

    kind: Kind = "room"
    exposure: float = 1.0

    @classmethod
    def fit(cls, grey: GreyImages, coverage: GreyImages, reference: GreyImages, mask: GreyImages) -> Alignment:
        """``room`` with the exposure of least absolute differences between all images of the part before its refinement
        and those of the object, encoded; arguments as for :meth:`__call__`."""
        inside = mask > 0.5
        part = _own_colour(grey.detach(), coverage)[inside]
        target = to_srgb(_own_colour(reference, mask))[inside]

        def difference(stops: float) -> float:
            return float((to_srgb(part * 2.0**stops) - target).abs().sum())

        best, reach = 0.0, LARGEST_STOPS
        for _ in range(REFINEMENTS):
            best = min((best + reach * i / 12 for i in range(-12, 13)), key=difference)
            reach /= 12
        return cls("room", 2.0**best)

    def __call__(
        self, grey: GreyImages, coverage: GreyImages, reference: GreyImages, mask: GreyImages
    ) -> tuple[GreyImages, GreyImages]:
        """Ĝ and G_gt as they are compared: sRGB-encoded, aligned; both 0 outside of the mask.

        grey, reference: linear, weighted by their coverage and mask as they come from the renderer. A pixel on the rim
        is encoded as the colour of the object at that place and weighted by the mask again, in both images alike.

        Rendering is linear; the comparison is not. LPIPS and SSIM are made for encoded images, and so are eyes: in
        linear light a dark blue window in a black door differs by 0.02 and is lost, encoded by 0.15.
        """
        part, target = _own_colour(grey, coverage), _own_colour(reference, mask)
        encoded = to_srgb(target)
        if self.kind == "room":
            return to_srgb(part * self.exposure) * mask, encoded * mask
        # A change of exposure is not affine in encoded values, so it is matched in linear light first
        inside = mask.sum(dim=(2, 3), keepdim=True).clamp_min(1e-6)
        light = (part * mask).sum(dim=(2, 3), keepdim=True).clamp_min(1e-6 * inside)
        part = to_srgb(part * (target * mask).sum(dim=(2, 3), keepdim=True) / light)
        align = align_robustly if self.kind == "robust" else align_moments
        return align(part, encoded, mask), encoded * mask


def _own_colour(grey: Tensor, weight: Tensor) -> Tensor:
    return grey / weight.clamp_min(1e-3)


def align_robustly(grey: GreyImages, reference: GreyImages, mask: GreyImages) -> GreyImages:
    """Ĝ: gain and offset of ``grey`` by iteratively reweighted least squares, 0 outside of the mask.

    Cauchy weights w = 1 / (1 + (r / 1.5 s)²) of the residuals r with s their median; the gain stays within
    :data:`GAIN`. The weights are constants of the gradient, the last fit is not: what a gain and an offset explain has
    no gradient.
    """
    aligned = grey
    weight = mask
    for _ in range(REWEIGHTINGS):
        with torch.no_grad():
            aligned = _fit(grey, reference, weight)
            residual = (reference - aligned).abs()
            median = _masked_median(residual, mask).clamp_min(SMALLEST_MEDIAN)
            weight = mask / (1 + (residual / (TUNING * median)).square())
    return _fit(grey, reference, weight) * mask


def _fit(grey: Tensor, reference: Tensor, weight: Tensor) -> Tensor:
    """``grey`` times the gain and plus the offset of the weighted least squares, the gain within :data:`GAIN`."""
    total = weight.sum(dim=(2, 3), keepdim=True).clamp_min(1e-6)

    def mean(x: Tensor) -> Tensor:
        return (x * weight).sum(dim=(2, 3), keepdim=True) / total

    grey_mean, reference_mean = mean(grey), mean(reference)
    variance = mean((grey - grey_mean).square())
    gain = mean((grey - grey_mean) * (reference - reference_mean)) / (variance + 1e-8)
    return (grey - grey_mean) * gain.clamp(*GAIN) + reference_mean


def _masked_median(x: Tensor, mask: Tensor) -> Tensor:
    """``[B,1,1,1]``: the median of each image of ``x [B,1,H,W]`` where the mask is at least a half."""
    inside = torch.where(mask >= 0.5, x, torch.nan)
    return torch.nan_to_num(inside.flatten(1).nanmedian(dim=1).values)[:, None, None, None]


def align_moments(grey: GreyImages, reference: GreyImages, mask: GreyImages) -> GreyImages:
    """Ĝ: ``grey`` with the mean and variance of ``reference`` inside the mask, 0 outside; ``[B,1,H,W]``.

    GenMF, mean–variance normalisation. It removes what one exposure and one contrast can explain, so that a different
    overall albedo costs nothing.
    """
    inside = mask.sum(dim=(2, 3), keepdim=True).clamp_min(1e-6)

    def moments(x: Tensor) -> tuple[Tensor, Tensor]:
        mean = (x * mask).sum(dim=(2, 3), keepdim=True) / inside
        variance = ((x - mean).square() * mask).sum(dim=(2, 3), keepdim=True) / inside
        return mean, (variance + 1e-12).sqrt()

    (mean, deviation), (target_mean, target_deviation) = moments(grey), moments(reference)
    return ((grey - mean) / deviation * target_deviation + target_mean) * mask

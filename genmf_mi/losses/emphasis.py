"""What of two images shall count, pixel by pixel: not at all where no relief is wanted, and more where it matters."""

from __future__ import annotations

from dataclasses import dataclass

from genmf_mi.losses.shapes import GreyImages


@dataclass(frozen=True)
class Emphasis:
    """Of one or more images.

    wanted: ``[B,1,H,W]`` in 0..1. Where it is 0 the part is taken to look as it should: its difference from the
        reference is none of its faults, and has no gradient.
    weight: ``[B,1,H,W]``, factor on the gradient with respect to the pixel, whichever term it comes from.
    """

    wanted: GreyImages
    weight: GreyImages

    def crop(self, window: tuple[slice, slice]) -> Emphasis:
        """The rows and columns of ``window``."""
        rows, columns = window
        return Emphasis(self.wanted[..., rows, columns], self.weight[..., rows, columns])

    def __call__(self, image: GreyImages, reference: GreyImages) -> GreyImages:
        """``image [B,1,H,W]`` as it counts when it is compared with ``reference [B,1,H,W]``."""
        image = reference + self.wanted * (image - reference)
        still = image.detach()
        return still + self.weight * (image - still)

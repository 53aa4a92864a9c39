"""How close pictures of the one-colour part come to those of the textured object, in numbers.

Both images are sRGB-encoded. The render is aligned to the reference, clipped to 0..1, background 0 in both. SSIM and
LPIPS are taken over the full frame, and once more inside the mask. The g-metrics compare the gradient magnitudes.

Scores are given twice: with one exposure for all views, and with the alignment of GenMF, under :data:`PAPER`, so that
figures can be compared with the paper's (:mod:`genmf_mi.losses.alignment`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

import numpy as np
import torch
from torch import Tensor

from genmf_mi.losses.alignment import Alignment
from genmf_mi.losses.appearance import gradient_magnitude
from genmf_mi.losses.lpips_weights import Network
from genmf_mi.losses.perceptual import features, lpips

PAPER = "paper_alignment"
"""Key of the scores with the alignment of GenMF."""
LEAST_WANTED = 0.01
"""Share of the object from which on the exposure is found where relief is wanted only."""

Name = TypeVar("Name")


class Pictured(Protocol):
    """Pictures of a part: linear grey values ``[B,1,H,W]``, weighted by the coverage ``[B,1,H,W]``."""

    @property
    def grey(self) -> Tensor: ...

    @property
    def coverage(self) -> Tensor | None: ...


@dataclass
class Scorer:
    """Scores pictures of parts against those of one textured object.

    target_grey: ``[B,1,H,W]`` the object, linear, weighted by its mask ``[B,1,H,W]``.
    networks: which LPIPS networks to report.
    wanted: ``[B,1,H,W]`` in 0..1, where texture without relief counts against a part; everywhere if None. Where it is
        0 a part is taken to look as the object does.
    """

    target_grey: Tensor
    mask: Tensor
    networks: tuple[Network, ...] = ("alex",)
    wanted: Tensor | None = None

    @torch.no_grad()
    def __post_init__(self) -> None:
        # The target is the same whatever the alignment
        _, target = Alignment()(self.target_grey, self.mask, self.target_grey, self.mask)
        self.target = target.clamp(0, 1)
        self.target_gradient = gradient_magnitude(self.target)

    @property
    def most_telling(self) -> int:
        """Index of the view in which the textured object has the most contrast."""
        inside = self.mask.sum(dim=(1, 2, 3)).clamp_min(1e-6)
        mean = (self.target * self.mask).sum(dim=(1, 2, 3)) / inside
        contrast = ((self.target - mean[:, None, None, None]).square() * self.mask).sum(dim=(1, 2, 3)) / inside
        return int(contrast.argmax())

    @property
    def compared(self) -> Tensor:
        """``[B,1,H,W]``: the mask where relief is wanted, or all of it where that is next to nothing."""
        if self.wanted is None or float((self.wanted * self.mask).sum()) < LEAST_WANTED * float(self.mask.sum()):
            return self.mask
        return self.mask * (self.wanted > 0.5)

    @torch.no_grad()
    def align(self, part: Pictured, alignment: Alignment) -> Tensor:
        """``[B,1,H,W]`` the part as it is compared: encoded, aligned, clipped, 0 outside of the mask."""
        assert part.coverage is not None
        aligned, _ = alignment(part.grey, part.coverage, self.target_grey, self.mask)
        aligned = aligned.clamp(0, 1)
        return aligned if self.wanted is None else torch.lerp(self.target, aligned, self.wanted)

    def verdicts(self, parts: Mapping[str, Pictured], alignment: Alignment) -> dict[str, Any]:
        """:meth:`scores` of the parts by name, with ``outline_iou``, and under :data:`PAPER` as the paper aligns."""
        alignments = {"": alignment, PAPER: Alignment("paper")}
        images = {(key, name): self.align(part, a) for key, a in alignments.items() for name, part in parts.items()}
        scores = self.scores(images)  # at once, so that the features of the reference are computed once
        table: dict[str, Any] = {name: scores["", name] for name in parts}
        for name, part in parts.items():
            assert part.coverage is not None
            table[name]["outline_iou"] = outline_iou(part.coverage, self.mask)
        return table | {PAPER: {name: scores[PAPER, name] for name in parts}}

    @torch.no_grad()
    def scores(
        self, images: Mapping[Name, Tensor], networks: tuple[Network, ...] | None = None
    ) -> dict[Name, dict[str, float | None]]:
        """Means over the views, of images ``[B,1,H,W]`` as :meth:`align` returns them, by the names of the parts.

        Keys: ``ssim``, ``g_ssim``, ``ssim_mask``, ``g_ssim_mask``, for each network ``lpips_*`` and ``lpips_mask_*``,
        and ``g_lpips`` (AlexNet). None stands for a network that was not asked for.
        """
        gradients = {name: gradient_magnitude(image) for name, image in images.items()}
        table: dict[Name, dict[str, float | None]] = {name: {} for name in images}
        for name, row in table.items():
            row["ssim"], row["ssim_mask"] = ssim(images[name], self.target, self.mask)
            row["g_ssim"], row["g_ssim_mask"] = ssim(gradients[name], self.target_gradient, self.mask)
            row |= dict.fromkeys(("lpips_alex", "lpips_vgg", "lpips_mask_alex", "lpips_mask_vgg"))
        for network in networks or self.networks:
            for name, (frame, inside) in self.lpips(images, network).items():
                table[name][f"lpips_{network}"], table[name][f"lpips_mask_{network}"] = frame, inside
        for name, (frame, _) in self.lpips(gradients, "alex", self.target_gradient).items():
            table[name]["g_lpips"] = frame
        return table

    @torch.no_grad()
    def lpips(
        self, images: Mapping[Name, Tensor], network: Network, target: Tensor | None = None
    ) -> dict[Name, tuple[float, float]]:
        """LPIPS over the frame and inside the mask, means over the views, against ``target [B,1,H,W]``, the reference
        if None. One view at a time: the features of VGG16 take 70 MB each."""
        target = self.target if target is None else target
        sums = {name: np.zeros(2) for name in images}
        for i in range(len(target)):
            expected, mask = features(target[i : i + 1], network), self.mask[i : i + 1]
            for name, image in images.items():
                actual = features(image[i : i + 1], network)
                sums[name] += [float(lpips(actual, expected)), float(lpips(actual, expected, mask=mask))]
        return {name: (float(total[0]) / len(target), float(total[1]) / len(target)) for name, total in sums.items()}


def outline_iou(coverage: Tensor, reference: Tensor) -> float:
    """Intersection over union of two silhouettes ``[B,1,H,W]`` in 0..1, mean over views."""
    both, either = (f(coverage, reference).sum(dim=(1, 2, 3)) for f in (torch.minimum, torch.maximum))
    return float((both / either.clamp_min(1e-6)).mean())


def ssim(image: Tensor, reference: Tensor, mask: Tensor) -> tuple[float, float]:
    """SSIM (Wang et al. 2004, scikit-image's 7 × 7 window, data range 1) over the frame and over the mask, means over
    views; all ``[B,1,H,W]``."""
    from skimage import metrics

    untyped: Any = metrics
    similarity: Callable[..., tuple[float, np.ndarray]] = untyped.structural_similarity
    frame: list[float] = []
    inside: list[float] = []
    for a, b, m in zip(image[:, 0].cpu().numpy(), reference[:, 0].cpu().numpy(), mask[:, 0].cpu().numpy(), strict=True):
        mean, local = similarity(a, b, data_range=1.0, full=True)
        frame.append(mean)
        inside.append(float((local * m).sum() / max(m.sum(), 1e-6)))
    return float(np.mean(frame)), float(np.mean(inside))

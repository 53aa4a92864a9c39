"""How close the one-colour part comes to the textured object, in numbers.

Protocol: six standard views at 384² with 16 samples per pixel, both images sRGB-encoded. The render is aligned to the
reference, clipped to 0..1, background 0 in both. SSIM and LPIPS are taken over the full frame, and once more inside the
mask. The g-metrics compare the gradient magnitudes. "Unseen" means six views between the standard ones, three under
each of two turned lightings that no iteration uses.

Scores are given twice: with one exposure for all views, and with the alignment of GenMF, under :data:`PAPER`, so that
figures can be compared with the paper's (:mod:`genmf_mi.losses.alignment`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
import torch
from torch import Tensor

from genmf_mi.losses.alignment import Alignment
from genmf_mi.losses.appearance import gradient_magnitude
from genmf_mi.losses.lpips_weights import Network
from genmf_mi.losses.perceptual import features, lpips
from genmf_mi.render import bridge
from genmf_mi.render.scene import Scene, View
from genmf_mi.render.target import Reference

RESOLUTION, SAMPLES, SEED = 384, 16, 999
UNSEEN_TURNS = ((20.0, 0.0), (-15.0, -15.0))
"""Turns of the lights in the unseen set, in degrees."""

PAPER = "paper_alignment"
"""Key of the scores with the alignment of GenMF."""

Name = TypeVar("Name")


def unseen_views(views: tuple[View, ...]) -> tuple[View, ...]:
    """Half-way between the standard views in azimuth, at other elevations, under the two unseen lightings."""
    around = sorted(views, key=lambda v: v.azimuth % 360)
    between: list[View] = []
    for i, (a, b) in enumerate(zip(around, [*around[1:], around[0]], strict=True)):
        azimuth = a.azimuth + (360 if a is b else (b.azimuth - a.azimuth) % 360) / 2
        between.append(View(azimuth % 360, (5.0, 35.0)[i % 2], UNSEEN_TURNS[2 * i // len(around)]))
    return tuple(between)


@dataclass
class Evaluator:
    """Scores parts against one reference from one set of views.

    alignment: see :func:`build_evaluator`. networks: which LPIPS networks to report. samples: rays per pixel.
    """

    reference: Reference
    scene: Scene
    views: tuple[View, ...]
    alignment: Alignment
    networks: tuple[Network, ...] = ("alex",)
    samples: int = SAMPLES

    @torch.no_grad()
    def __post_init__(self) -> None:
        self.reference.scene.resize(self.scene.resolution)  # iterations may have rendered it smaller
        target = self.reference.render(self.views, seed=SEED, samples=self.samples)
        self.target_grey, (_, _, self.mask) = target.grey, target.geometry
        self.target = self.alignment(target.grey, self.mask, target.grey, self.mask)[1].clamp(0, 1)
        self.target_gradient = gradient_magnitude(self.target)

    @property
    def device(self) -> torch.device:
        return self.target.device

    @torch.no_grad()
    def render(self, vertices: Tensor, faces: Tensor | None = None) -> bridge.Buffers:
        """The part as it is lit, before any alignment; arguments as for :func:`bridge.render`."""
        return bridge.render(self.scene, self.views, vertices, faces, seed=SEED, samples=self.samples)

    @property
    def most_telling(self) -> int:
        """Index of the view in which the textured object has the most contrast."""
        inside = self.mask.sum(dim=(1, 2, 3)).clamp_min(1e-6)
        mean = (self.target * self.mask).sum(dim=(1, 2, 3)) / inside
        contrast = ((self.target - mean[:, None, None, None]).square() * self.mask).sum(dim=(1, 2, 3)) / inside
        return int(contrast.argmax())

    def render_colour(self, views: Sequence[View], samples: int = 0) -> np.ndarray:
        """``[B,H,W,3]`` the textured object, see :meth:`Reference.render_colour`; the evaluator's samples if 0."""
        self.reference.scene.resize(self.scene.resolution)
        return self.reference.render_colour(views, seed=SEED, samples=samples or self.samples)

    @torch.no_grad()
    def align(self, part: bridge.Buffers, alignment: Alignment | None = None) -> Tensor:
        """``[B,1,H,W]`` the part as it is compared: encoded, aligned, clipped, 0 outside of the mask."""
        _, _, coverage = part.geometry
        aligned, _ = (alignment or self.alignment)(part.grey, coverage, self.target_grey, self.mask)
        return aligned.clamp(0, 1)

    def aligned(self, vertices: Tensor, faces: Tensor | None = None) -> Tensor:
        """:meth:`align` of a shape, arguments as for :func:`bridge.render`."""
        return self.align(self.render(vertices, faces))

    def verdicts(self, parts: Mapping[str, bridge.Buffers]) -> dict[str, Any]:
        """:meth:`scores` of the parts by name, with ``outline_iou``, and under :data:`PAPER` as the paper aligns."""
        table: dict[str, Any] = self.scores({name: self.align(part) for name, part in parts.items()})
        for name, part in parts.items():
            table[name]["outline_iou"] = outline_iou(part.geometry[2], self.mask)
        paper = {name: self.align(part, Alignment("paper")) for name, part in parts.items()}
        return table | {PAPER: self.scores(paper)}

    def score(self, image: Tensor, networks: tuple[Network, ...] | None = None) -> dict[str, float | None]:
        """:meth:`scores` of a single part."""
        return self.scores({"part": image}, networks)["part"]

    @torch.no_grad()
    def scores(
        self, images: Mapping[str, Tensor], networks: tuple[Network, ...] | None = None
    ) -> dict[str, dict[str, float | None]]:
        """Means over the views, of images ``[B,1,H,W]`` as :meth:`aligned` returns them, by the names of the parts.

        Keys: ``ssim``, ``g_ssim``, ``ssim_mask``, ``g_ssim_mask``, for each network ``lpips_*`` and ``lpips_mask_*``,
        and ``g_lpips`` (AlexNet). None stands for a network that was not asked for.
        """
        gradients = {name: gradient_magnitude(image) for name, image in images.items()}
        table: dict[str, dict[str, float | None]] = {name: {} for name in images}
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


@torch.no_grad()
def build_evaluator(reference: Reference, part: Scene, networks: tuple[Network, ...]) -> Evaluator:
    """The evaluator of the standard views, with one exposure for all parts and all views.

    part: holds the part before its refinement.
    """
    evaluator = Evaluator(reference, part, reference.views, Alignment(), networks)
    shown = bridge.render(part, reference.views, seed=SEED, samples=SAMPLES)
    evaluator.alignment = Alignment.fit(shown.grey, shown.geometry[2], evaluator.target_grey, evaluator.mask)
    return evaluator


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

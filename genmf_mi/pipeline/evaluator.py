"""How close the one-colour part comes to the textured object: what is looked at.

Protocol: six standard views at 384² with 16 samples per pixel. "Unseen" means six views between the standard ones,
three under each of two turned lightings that no iteration uses. How the images are compared is told in
:mod:`genmf_mi.pipeline.scoring`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from genmf_mi.losses.alignment import Alignment
from genmf_mi.losses.lpips_weights import Network
from genmf_mi.pipeline.region_images import RegionImages
from genmf_mi.pipeline.scoring import Pictured, Scorer
from genmf_mi.render import bridge
from genmf_mi.render.scene import Scene, View
from genmf_mi.render.target import Reference

RESOLUTION, SAMPLES, SEED = 384, 16, 999
UNSEEN_TURNS = ((20.0, 0.0), (-15.0, -15.0))
"""Turns of the lights in the unseen set, in degrees."""


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
    regions: where relief is wanted; everywhere if None.
    """

    reference: Reference
    scene: Scene
    views: tuple[View, ...]
    alignment: Alignment
    networks: tuple[Network, ...] = ("alex",)
    samples: int = SAMPLES
    regions: RegionImages | None = None

    @torch.no_grad()
    def __post_init__(self) -> None:
        self.reference.scene.shade_as(self.scene)  # iterations may have rendered it smaller, and without layers
        target = self.reference.render(self.views, seed=SEED, samples=self.samples)
        _, _, mask = target.geometry
        wanted = self.regions.emphasis(self.views, mask.device).wanted if self.regions else None
        self.scorer = Scorer(target.grey, mask, self.networks, wanted)

    @property
    def target_grey(self) -> Tensor:
        """``[B,1,H,W]`` the textured object, linear, weighted by the mask."""
        return self.scorer.target_grey

    @property
    def mask(self) -> Tensor:
        """``[B,1,H,W]`` of the textured object."""
        return self.scorer.mask

    @property
    def target(self) -> Tensor:
        """``[B,1,H,W]`` the textured object as it is compared."""
        return self.scorer.target

    @property
    def device(self) -> torch.device:
        return self.target.device

    @torch.no_grad()
    def render(self, vertices: Tensor, faces: Tensor | None = None) -> bridge.Buffers:
        """The part as it is lit, before any alignment; arguments as for :func:`bridge.render`."""
        return bridge.render(self.scene, self.views, vertices, faces, seed=SEED, samples=self.samples)

    def render_colour(self, views: Sequence[View], samples: int = 0) -> np.ndarray:
        """``[B,H,W,3]`` the textured object, see :meth:`Reference.render_colour`; the evaluator's samples if 0."""
        self.reference.scene.shade_as(self.scene)
        return self.reference.render_colour(views, seed=SEED, samples=samples or self.samples)

    def align(self, part: Pictured, alignment: Alignment | None = None) -> Tensor:
        """``[B,1,H,W]`` the part as it is compared: encoded, aligned, clipped, 0 outside of the mask."""
        return self.scorer.align(part, alignment or self.alignment)

    def aligned(self, vertices: Tensor, faces: Tensor | None = None) -> Tensor:
        """:meth:`align` of a shape, arguments as for :func:`bridge.render`."""
        return self.align(self.render(vertices, faces))

    def verdicts(self, parts: Mapping[str, Pictured]) -> dict[str, Any]:
        """See :meth:`Scorer.verdicts`."""
        return self.scorer.verdicts(parts, self.alignment)

    def score(self, image: Tensor, networks: tuple[Network, ...] | None = None) -> dict[str, float | None]:
        """:meth:`Scorer.scores` of a single part."""
        return self.scorer.scores({"part": image}, networks)["part"]


@torch.no_grad()
def build_evaluator(
    reference: Reference,
    part: Scene,
    networks: tuple[Network, ...],
    vertices: Tensor | None = None,
    regions: RegionImages | None = None,
) -> Evaluator:
    """The evaluator of the standard views, with one exposure for all parts and all views.

    vertices: ``[V,3]`` of the part before its refinement; None if ``part`` still holds it.
    regions: see :class:`Evaluator`.
    """
    evaluator = Evaluator(reference, part, reference.views, Alignment(), networks, regions=regions)
    shown = bridge.render(part, reference.views, vertices, seed=SEED, samples=SAMPLES)
    compared = evaluator.scorer.compared
    evaluator.alignment = Alignment.fit(shown.grey, shown.geometry[2], evaluator.target_grey, compared)
    return evaluator

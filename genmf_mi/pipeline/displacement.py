"""The baseline: offset the surface by brightness, as texture-to-relief tools do.

Both signs and several amplitudes are tried, and the one with the lowest LPIPS wins. It is scored beside the
refinement in every report, and the refinement starts from it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch

from genmf_mi.assets.sdf_asset import SdfAsset
from genmf_mi.core.config import RefineConfig
from genmf_mi.core.progress import Progress
from genmf_mi.losses.perceptual import features, lpips
from genmf_mi.pipeline.detail import span
from genmf_mi.pipeline.evaluator import Evaluator
from genmf_mi.pipeline.problem import ONE_BRIGHTNESS, RefinementProblem

AMPLITUDES = (-1.0, -0.5, -0.25, 0.25, 0.5, 1.0)
"""Shares of the cap; positive raises what is bright."""
SAMPLES = 4
"""Rays per pixel of the images by which amplitudes are compared."""
START, FEW = 0.3, 100
"""Share of the displacement that an optimisation starts from; with fewer iterations, and on a field, which moves more
slowly, from all of it."""


@dataclass(frozen=True)
class Displacement:
    """heights: ``[V]`` along the normals, normalised units. amplitude: one of :data:`AMPLITUDES`."""

    heights: np.ndarray
    amplitude: float


def heights(problem: RefinementProblem, amplitude: float) -> np.ndarray:
    """``[V]`` normalised units: brightness about its median, its :func:`span` twice ``amplitude`` times the bounds, cut
    off at the bounds. An object of one brightness stays as it is."""
    brightness = problem.surface.brightness
    low, high = span(brightness[problem.relief])
    if high - low < ONE_BRIGHTNESS:
        return np.zeros(len(brightness))
    brightness = np.clip((brightness - low) / (high - low), 0, 1)
    share = np.clip(2 * amplitude * (brightness - np.median(brightness[problem.relief])), -1, 1)
    return share * np.where(share > 0, problem.loose_bounds.outward, problem.loose_bounds.inward)


def best_displacement(problem: RefinementProblem, evaluator: Evaluator, progress: Progress) -> Displacement:
    """The displacement with the lowest LPIPS (AlexNet) over the evaluator's views, at half their resolution."""
    progress.stage("displacing by brightness")
    surface, pair, scores = problem.surface, problem.evaluation, dict.fromkeys(AMPLITUDES, 0.0)
    resolution = pair.part.resolution
    pair.resize(resolution // 2)
    quick = replace(evaluator, samples=SAMPLES)
    target = features(quick.target)
    for amplitude in AMPLITUDES:
        vertices = surface.vertices + heights(problem, amplitude)[:, None] * surface.normals
        image = quick.aligned(torch.as_tensor(vertices, dtype=torch.float32, device=quick.device))
        scores[amplitude] = float(lpips(image, target).mean())
    pair.resize(resolution)
    amplitude = min(AMPLITUDES, key=lambda each: scores[each])
    return Displacement(heights(problem, amplitude), amplitude)


def initial_heights(problem: RefinementProblem, displacement: Displacement, config: RefineConfig) -> np.ndarray:
    """``[V]`` heights to start an optimisation from: a share of the displacement, without its low-frequency component.

    Shading sees slopes, not heights: a plateau costs the relief that its rim needs, and shows nothing. And offsets that
    start near their bounds stay there, because tanh has no slope; all of the displacement is a worse start than none,
    unless the iterations are too few to come as far. Under lamps with shadows, a steep rim is worth more than a slope.
    """
    whole = isinstance(problem.asset, SdfAsset) or config.iterations < FEW or config.shadows
    return (1.0 if whole else START) * (displacement.heights - problem.low_pass.of(displacement.heights))

"""What an iteration looks at: from where, how closely, and in how many pixels.

Everything here is a function of the settings and of the number of the iteration, so that a resumed run sees the same.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from genmf_mi.core.config import RefineConfig
from genmf_mi.pipeline.problem import RefinementProblem
from genmf_mi.pipeline.region_images import RegionImages
from genmf_mi.render.view import View, project

COARSE, COARSE_SHARE, SMALLEST_IMAGE = 2 / 3, 0.6, 64
"""Share of the resolution at first; for what share of the iterations; and pixels per side at least."""
CLOSE_EVERY, CLOSE_EVERY_COARSE, ZOOM = 4, 2, 2.0
"""Of so many views, one looks closely at something small; as long as the images are small, which blurs it; and how
closely."""
FAINTEST, STEEPEST = 1e-4, 85.0
"""Contrast that may draw a close view to a place; and the elevation of such a view at most, in degrees."""
POLAR_EVERY, POLAR_PHASE = 8, 2
"""Of so many views, that one is from above or from below."""
POLAR_ELEVATIONS = 35.0, 85.0
"""Degrees, positive above and negative below; the standard views and their jitter reach as far as the first."""

GOLDEN_RATIO = (5**0.5 - 1) / 2

Kind = Literal["standard", "close", "polar"]
Turn = tuple[float, float]


def is_coarse(config: RefineConfig, index: int) -> bool:
    """Whether iteration ``index`` is one of the first, for which small images do."""
    return index < COARSE_SHARE * config.iterations


def resolution(config: RefineConfig, index: int) -> int:
    """Pixels per side at iteration ``index``."""
    return max(SMALLEST_IMAGE, round(COARSE * config.resolution)) if is_coarse(config, index) else config.resolution


def kind(config: RefineConfig, index: int) -> Kind:
    """Which kind of view iteration ``index`` has."""
    every = CLOSE_EVERY_COARSE if is_coarse(config, index) else CLOSE_EVERY
    if index % every == every - 1:
        return "close"
    return "polar" if index % POLAR_EVERY == POLAR_PHASE else "standard"


def sample_view(problem: RefinementProblem, config: RefineConfig, index: int) -> View:
    """The view of iteration ``index``.

    One of the standard views, each equally often, moved at random, with the lights turned at random; or one from high
    above or far below; or a close one of something small. Pictures are of one view under one light and stay as they
    are.
    """
    views, pictures = problem.training.reference.views, problem.training.reference.pictures
    if pictures:
        return _standard(views, config.seed, index)
    rng = np.random.default_rng([config.seed, index, 1])
    shift = rng.uniform(-1, 1, 2) * config.view_jitter
    right, up = rng.uniform(-1, 1, 2) * config.light_jitter
    turn = float(right), float(up)
    match kind(config, index):
        case "close":
            return _close(problem, rng, shift, turn)
        case "polar":
            side = 1 if index // POLAR_EVERY % 2 == 0 else -1
            return View(rng.uniform(0, 360), side * rng.uniform(*POLAR_ELEVATIONS), turn)
        case "standard":
            before = sum(kind(config, i) == "standard" for i in range(index))
            view = _standard(views, config.seed, before, problem.region_images)
            return View(view.azimuth + float(shift[0]), view.elevation + float(shift[1]), turn)


def _standard(views: tuple[View, ...], seed: int, turn: int, regions: RegionImages | None = None) -> View:
    """All of ``views`` in a new order every time they were all used; or, with regions, each as often as what it shows
    counts."""
    if regions is not None:
        # Multiples of the golden ratio fall evenly into intervals of any width
        start = np.random.default_rng(seed).uniform()
        upto = np.cumsum(regions.shares)
        at = (start + turn * GOLDEN_RATIO) % 1 * float(upto[-1])
        return views[min(int((upto <= at).sum()), len(views) - 1)]
    order = np.random.default_rng([seed, turn // len(views)]).permutation(len(views))
    return views[int(order[turn % len(views)])]


def _close(problem: RefinementProblem, rng: np.random.Generator, shift: np.ndarray, turn: Turn) -> View:
    """Something small, chosen in proportion to its contrast, ``shift`` degrees of azimuth and elevation off head on."""
    surface, scene = problem.surface, problem.training.part
    # Triangles are small where the texture is fine, so that vertices are many there
    contrast = problem.detail + FAINTEST
    if problem.regions is not None:
        contrast = contrast * problem.regions.mask * problem.regions.weight
    chosen = int(rng.choice(len(contrast), p=contrast / contrast.sum()))
    front = View.facing(surface.normals[chosen])
    elevation = float(np.clip(front.elevation + shift[1], -STEEPEST, STEEPEST))
    view = View(front.azimuth + float(shift[0]), elevation, turn, ZOOM)
    # The window stays within the image
    reach = 0.5 - 0.5 / ZOOM
    x, y = np.clip(project(surface.vertices[chosen][None], view, scene.distance, scene.half_width)[0], -reach, reach)
    return replace(view, centre=(float(x), float(y)))

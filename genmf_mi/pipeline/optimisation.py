"""The loop of a refinement: one view, one gradient, one step at a time.

The first stage looks at the appearance alone; the second also keeps the predicted thermal stress down.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
import torch
from torch import Tensor

from genmf_mi.core import memory
from genmf_mi.core.config import RefineConfig
from genmf_mi.core.errors import ConfigError, OptimisationError, OutputError
from genmf_mi.core.progress import Progress
from genmf_mi.geometry.parameterization import Geometry, Parameterization
from genmf_mi.geometry.uniform_adam import UniformAdam
from genmf_mi.losses import objective
from genmf_mi.losses.alignment import Alignment
from genmf_mi.pipeline import views
from genmf_mi.pipeline.checkpoint import Checkpoint
from genmf_mi.pipeline.problem import RefinementProblem
from genmf_mi.pipeline.run_folder import RunFolder
from genmf_mi.pipeline.shadows import shadowed
from genmf_mi.pipeline.stress_stage import StressStage
from genmf_mi.render import bridge
from genmf_mi.render.bridge import Buffers

CHECKPOINT_EVERY = 25
"""Iterations between checkpoints."""
SHOWING_SHARE = 0.04
"""Of the time, at most, for pictures of the part between the checkpoints."""
WARM_UP, COOL_DOWN = 10, 0.4
"""Iterations over which the learning rate grows to its full size, and the share of all iterations over which it falls
again."""
RATE_WITH_SHADOWS = 2.0
"""Factor on the learning rate where shadows are looked at: rims have to move farther than slopes."""
PATIENCE = 5
"""Iterations in a row without a single finite gradient after which the refinement gives up."""

ExtraTerms = Callable[[Buffers, Buffers, Geometry], dict[str, Tensor]]
"""From the render, the reference and the geometry of an iteration to further terms of the loss, weighted scalars by
name."""


@dataclass
class Optimisation:
    """What the iterations read and change.

    iteration: number of iterations made. history: the record of each.
    stage_one: the state in which stage two began.
    """

    problem: RefinementProblem
    config: RefineConfig
    parameterization: Parameterization
    alignment: Alignment
    stress: StressStage | None = None
    extra_terms: ExtraTerms | None = None
    iteration: int = 0
    history: list[dict[str, Any]] = field(default_factory=list[dict[str, Any]])
    stage_one: Checkpoint | None = None

    def __post_init__(self) -> None:
        self.optimiser = UniformAdam(
            self.parameterization.parameters, self.config.learning_rate, floor=self.config.gradient_floor
        )

    def checkpoint(self) -> Checkpoint:
        """A copy of all that the next iteration depends on."""
        stress = self.stress.state_dict() if self.stress else {}
        return Checkpoint.of(self.iteration, self.parameterization.parameters, self.optimiser, stress, self.stage_one)

    def restore(self, checkpoint: Checkpoint) -> None:
        """Return to a :meth:`checkpoint`.

        Raises:
            ConfigError: it is of another mesh. OutputError: it is damaged.
        """
        parameters = self.parameterization.parameters
        if [p.shape for p in parameters] != [p.shape for p in checkpoint.parameters]:
            raise ConfigError(
                "the checkpoint belongs to another mesh: was the asset changed since? Start again with --force."
            )
        with torch.no_grad():
            for parameter, value in zip(parameters, checkpoint.parameters, strict=True):
                parameter.copy_(value)
        try:
            self.optimiser.load_state_dict(checkpoint.optimiser)
            if self.stress:
                self.stress.load_state_dict(checkpoint.stress, self.parameterization)
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise OutputError("the checkpoint is damaged. Start again with --force.") from error
        self.iteration, self.stage_one = checkpoint.iteration, checkpoint.stage_one
        del self.history[self.iteration :]


def optimise(
    optimisation: Optimisation,
    run: RunFolder | None,
    progress: Progress,
    *,
    resume: bool = False,
    show: Callable[[Tensor, Tensor | None], None] | None = None,
) -> bool:
    """Make all iterations that are left, saving checkpoints on the way.

    show: is given the vertices and the faces before the first iteration, and again and again on the way.

    A KeyboardInterrupt, or a request to stop in the run folder, ends the optimisation with the last complete iteration;
    a SystemExit saves that and goes on.

    Returns:
        Whether it was interrupted.
    """
    if resume and run is not None:
        checkpoint, optimisation.history = run.load()
        optimisation.restore(checkpoint)
    progress.stage("refining")

    pictures = _Pictures(optimisation, show)
    pictures.take()
    checkpoint, interrupted = optimisation.checkpoint(), False
    try:
        for record in iterations(optimisation):
            checkpoint = optimisation.checkpoint()
            progress.advance(optimisation.iteration, optimisation.config.iterations, record)
            if optimisation.iteration % CHECKPOINT_EVERY == 0:
                memory.trim_malloc()
                if run is not None:
                    run.save(checkpoint, optimisation.history)
                pictures.take()
            elif pictures.due:
                pictures.take()
            if run is not None and run.stop_requested and optimisation.iteration < optimisation.config.iterations:
                interrupted = True
                progress.stage("asked to stop: finishing with the relief so far")
                break
    except KeyboardInterrupt:
        interrupted = True
        optimisation.restore(checkpoint)  # it may have come in the middle of a step
        progress.stage("interrupted: finishing with the relief so far")
    except SystemExit:  # the process was told to end (SIGTERM)
        if run is not None:
            run.save(checkpoint, optimisation.history[: checkpoint.iteration])
        raise
    if run is not None:
        run.save(checkpoint, optimisation.history)
    return interrupted


class _Pictures:
    """Shows the part so far, and knows when that can be afforded again."""

    def __init__(self, optimisation: Optimisation, show: Callable[[Tensor, Tensor | None], None] | None) -> None:
        self._optimisation, self._show = optimisation, show
        self._cost = self._last = 0.0

    @property
    def due(self) -> bool:
        return time.perf_counter() - self._last > self._cost / SHOWING_SHARE

    @torch.no_grad()
    def take(self) -> None:
        if self._show is not None:
            start = time.perf_counter()
            geometry = self._optimisation.parameterization.geometry()
            self._show(geometry.vertices, geometry.faces)
            self._last = time.perf_counter()
            self._cost = self._last - start


def iterations(optimisation: Optimisation) -> Iterator[dict[str, Any]]:
    """Make the iterations that are left; yields the record of each."""
    config, stress, start = optimisation.config, optimisation.stress, time.perf_counter()
    entries, without_gradient = sum(p.numel() for p in optimisation.parameterization.parameters), 0
    while optimisation.iteration < config.iterations:
        index = optimisation.iteration
        if stress and not stress.begun and index >= stress.first:
            optimisation.stage_one = optimisation.checkpoint()
            stress.begin(optimisation.parameterization)
        losses = step(optimisation)
        stage = 2 if stress and stress.begun else 1
        record = {"iteration": index, "stage": stage, **losses, "seconds": round(time.perf_counter() - start, 3)}
        optimisation.history.append(record)
        optimisation.iteration += 1
        finite = np.isfinite(losses["loss"]) and losses.get("nonfinite_gradients", 0) < entries
        without_gradient = 0 if finite else without_gradient + 1
        if without_gradient == PATIENCE:
            raise OptimisationError(
                f"the loss or all of its gradient was not finite for {PATIENCE} iterations. Use a lower "
                "--learning-rate; if that does not help, please report this with the asset."
            )
        yield record


def step(optimisation: Optimisation) -> dict[str, float]:
    """One view, one gradient, one step; returns the loss and its terms."""
    problem, config, index = optimisation.problem, optimisation.config, optimisation.iteration
    parameterization, optimiser, stress = optimisation.parameterization, optimisation.optimiser, optimisation.stress

    problem.training.resize(views.resolution(config, index))
    view = views.sample_view(problem, config, index)
    reference = problem.training.reference.render([view], seed=index)
    geometry = parameterization.geometry()
    image = bridge.render(problem.training.part, [view], geometry.vertices, geometry.faces, seed=index)

    if config.shadows:
        scene, mm = problem.training.part, problem.frame.mm_per_unit
        image, reference = shadowed(image, scene, view, mm), shadowed(reference, scene, view, mm)

    regions = problem.region_images
    emphasis = regions.emphasis([view], image.grey.device) if regions else None
    terms = objective.terms(image, reference, config.weights, optimisation.alignment, config.grain, emphasis)
    terms |= objective.with_weight(geometry.terms, config.weights)
    weights, figures = asdict(config.weights), {}
    if optimisation.extra_terms:
        extra = optimisation.extra_terms(image, reference, geometry)
        terms, weights = terms | extra, weights | dict.fromkeys(extra, 1.0)
    if stress and stress.begun:
        terms["stress"], weights["stress"], figures = stress.term(geometry, parameterization.parameters[0], optimiser)
    loss = objective.weighted_sum(terms, weights)
    loss.backward()  # pyright: ignore[reportUnknownMemberType]

    factors = parameterization.learning_rates(index / config.iterations)
    rate = config.learning_rate * schedule(index, config.iterations) * (RATE_WITH_SHADOWS if config.shadows else 1.0)
    optimiser.rates = [factor * rate for factor in factors]
    optimiser.step()
    if optimiser.nonfinite:
        figures["nonfinite_gradients"] = optimiser.nonfinite
    return {
        "loss": float(loss.detach()),
        "gradient_scale": optimiser.scale,
        **{name: float(term.detach()) for name, term in terms.items()},
        **figures,
    }


def schedule(index: int, count: int) -> float:
    """Factor on the learning rate at iteration ``index`` of ``count``: a short rise, a plateau, a fall to a tenth."""
    rise = min(1.0, (index + 1) / WARM_UP)
    fall = min(1.0, (count - index) / (COOL_DOWN * count))
    return rise * max(0.1, fall)

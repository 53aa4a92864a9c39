"""The refinement, from top to bottom: prepare, start, optimise in two stages, untangle, judge, write.

The first stage looks at the appearance alone; the second also keeps predicted thermal stress down.

import genmf_mi

result = genmf_mi.refine("bus.glb", genmf_mi.RefineConfig(size_mm=80))
result.vertices_mm, result.faces, result.metrics["after"]["lpips_alex"]
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from genmf_mi.core.config import RefineConfig
from genmf_mi.core.errors import ConfigError
from genmf_mi.pipeline.run_folder import Run

if TYPE_CHECKING:
    from torch import Tensor

    from genmf_mi.assets.asset import Asset
    from genmf_mi.assets.sdf_asset import SdfAsset
    from genmf_mi.geometry.mesh import UniformAdam
    from genmf_mi.pipeline.problem import RefinementProblem
    from genmf_mi.pipeline.results import Result
    from genmf_mi.stress.penalty import StressPenalty

CHECKPOINT_EVERY = 25
"""Iterations between checkpoints."""
SHAPES = ("before", "unconstrained", "after")
"""What can be verified."""
WARM_UP, COOL_DOWN = 10, 0.4
"""Iterations over which the step grows to its full size, and the share of all iterations over which it shrinks
again."""
THIN = 0.1
"""Part of the surface under which a part may be thinner than two cells of the stress grid and have a second stage."""


class Listener:
    """What a caller may want to hear while a refinement runs; this one hears nothing."""

    def say(self, text: str) -> None:
        """A new step has begun."""

    def iteration(self, index: int, count: int, terms: dict[str, float]) -> None:
        """Iteration ``index`` of ``count`` is done; its loss terms."""


def refine(
    asset: str | Path | Asset | SdfAsset,
    config: RefineConfig | None = None,
    *,
    textured: str | Path | Asset | None = None,
    out: str | Path | None = None,
    scene: str | Path | None = None,
    references: tuple[str, ...] = (),
    verify: bool | Collection[str] = False,
    force: bool = False,
    resume: bool = False,
    save_exr: bool = False,
    listener: Listener | None = None,
) -> Result:
    """Turn a textured asset into a one-colour part whose relief shows the texture.

    asset: a file, the name of a bundled sample, a loaded :class:`genmf_mi.assets.asset.Asset`, or a shape as a generator
        holds it, :class:`genmf_mi.assets.sdf_asset.SdfAsset`, whose field is refined in place of a mesh's vertices.
    textured: the mesh that has the colours of a generator's file.
    out: folder for all files; None writes nothing.
    scene: a scene file; the sample's own or ``default.xml`` if None.
    references: images to match instead of the texture, each ``image.png@azimuth,elevation``.
    verify: simulate the stress of the part ``before``, as it would be without the second stage (``unconstrained``), and
        ``after``, or of some of these by name; takes minutes.
    force, resume: replace a run in ``out``, or continue an interrupted one.

    A KeyboardInterrupt ends the optimisation early: the part so far is finished and written, and
    ``metrics["interrupted"]`` is set.

    Raises:
        GenmfError: what the command line prints; see :mod:`genmf_mi.core.errors`.
    """
    from genmf_mi.assets import sources
    from genmf_mi.core import memory
    from genmf_mi.losses import lpips_weights as weights
    from genmf_mi.pipeline import problem as prepare
    from genmf_mi.render import scene as scenes
    from genmf_mi.render import variant

    memory.tune_malloc()
    config, listener = config or RefineConfig(), listener or Listener()
    seconds, started = {}, time.perf_counter()

    listener.say("loading")
    asset = sources.load(asset, textured)
    device = variant.use(config.device)
    weights.require(*config.networks)
    xml = Path(scene) if scene else scenes.find(asset.name)
    run = Run.open(out, asset.name, config, force=force, resume=resume) if out else None
    if resume and run is None:
        raise ConfigError("there is nothing to resume without an output folder: give --out.")

    seconds["load"] = time.perf_counter() - started
    with tempfile.TemporaryDirectory(prefix="genmf-") as folder:
        piece = prepare.prepare(asset, config, xml, Path(folder), references=references, say=listener.say)
        seconds |= piece.seconds
        job = _Job(piece, config, device, listener)
        job.start()
        seconds["displacement"] = job.lap()
        interrupted = False
        if config.method == "relief":
            interrupted = job.optimise(run, resume)
        seconds["optimise"] = job.lap()
        if verify and not interrupted:
            job.verify(SHAPES if verify is True else verify)
            seconds["verify"] = job.lap()
        return job.finish(run, seconds, started, interrupted, save_exr)


class _Job:
    """The state that the steps of one refinement share."""

    def __init__(self, piece: RefinementProblem, config: RefineConfig, device: str, listener: Listener) -> None:
        from genmf_mi.pipeline.evaluation import Evaluator

        self._clock = time.perf_counter()
        self.piece, self.config, self.device, self.listener = piece, config, device, listener
        listener.say("rendering the references")
        self.judge = Evaluator(piece.judged_reference, piece.judged_part, piece.reference.views, config.networks)
        self.history: list[dict] = []
        self.balance, self.fork, self.verdict, self.left_out = 0.0, {}, {}, ""
        self.without_stress: tuple[np.ndarray, np.ndarray] | None = None

    def lap(self) -> float:
        """Seconds since the last call."""
        before, self._clock = self._clock, time.perf_counter()
        return self._clock - before

    def start(self) -> None:
        """Find the best displacement by brightness and put the relief's start there."""
        from genmf_mi.pipeline import displacement

        piece, config = self.piece, self.config
        self.displaced, self.amplitude = displacement.best(piece, self.judge, self.listener.say)
        self.relief = piece.movable(config, self.device)
        if config.method == "relief":
            self.relief.start_from(displacement.start(piece, self.displaced))
        else:
            self.reached = self.relief.displaced(self.displaced)

    def optimise(self, run: Run | None, resume: bool) -> bool:
        """Stage one and, unless it is turned off, stage two. Returns whether it was interrupted."""
        from genmf_mi.core import memory

        config, adam, first = self.config, self.optimiser(), 0
        if resume:
            state, self.history = run.load()
            first = int(state["iteration"])
            self.restore(state, adam)
        self.left_out = self.too_thin() if config.stress else ""
        kept, interrupted, began = self.state(first, adam), False, time.perf_counter()
        try:
            for index, stage, values in self.steps(first, adam, config.stress and not self.left_out):
                self.history.append(
                    {"iteration": index, "stage": stage, **values, "seconds": round(time.perf_counter() - began, 3)}
                )
                kept = self.state(index + 1, adam)
                self.listener.iteration(index, config.iterations, values)
                if (index + 1) % CHECKPOINT_EVERY == 0:
                    memory.trim_malloc()
                    if run:
                        run.save(kept, self.history)
        except KeyboardInterrupt:
            interrupted = True
            # It may have come in the middle of a step
            self.restore(kept, adam)
            del self.history[int(kept["iteration"]) :]
            self.listener.say("interrupted: finishing with the relief so far")
        if run:
            run.save(kept, self.history)
        self.reached = self.relief.reached()
        return interrupted

    def optimiser(self) -> UniformAdam:
        """One that has made no step yet."""
        from genmf_mi.geometry.mesh import UniformAdam

        relief, config = self.relief, self.config
        return UniformAdam(relief.latent, config.learning_rate, floor=config.gradient_floor, blocks=relief.blocks)

    def steps(self, first: int, adam: UniformAdam, constrained: bool) -> Iterator[tuple[int, int, dict[str, float]]]:
        """Make the iterations from ``first`` on; yields index, stage and losses after each."""
        stress, config = None, self.config
        for index in range(first, config.iterations):
            if constrained and stress is None and index >= config.stage_one_share * config.iterations:
                self.fork = self.fork or self.state(index, adam)
                stress = self.stage_two()
            values = self.step(index, adam, stress)
            yield index, 1 if stress is None else 2, values

    def too_thin(self) -> str:
        """Why there can be no second stage; empty if there can. What the grid of the stress loses seems free of stress,
        so that thin walls would be made thinner still."""
        from genmf_mi.sdf.distance import lost_fraction, signed_distance
        from genmf_mi.stress.fem.simulation import Settings

        surface = self.piece.vertices, self.piece.faces
        lost = lost_fraction(*surface, signed_distance(*surface, Settings().grid))
        if lost <= THIN:
            return ""
        reason = f"walls are too thin to predict their stress under {lost:.0%} of the surface"
        self.listener.say(f"no stress stage: {reason}")
        return reason

    def stage_two(self) -> StressPenalty:
        """What tells how far the part's stress is above that of the initial shape."""
        from genmf_mi.stress.model.predictor import Predictor
        from genmf_mi.stress.penalty import StressPenalty

        predictor = Predictor(device=self.device)
        distance = self.relief.distance(predictor.settings.grid)
        return StressPenalty(predictor, distance, self.relief.initial, self.config.stress_every)

    def step(self, index: int, adam: UniformAdam, stress: StressPenalty | None) -> dict[str, float]:
        """One view, one gradient, one step; returns the loss and its terms."""
        from genmf_mi.losses import objective
        from genmf_mi.render import bridge

        piece, config = self.piece, self.config
        view, reference = self.look(index)
        moved = self.relief.moved()
        image = bridge.render(piece.part, [view], moved.vertices, moved.faces, seed=index)
        terms = objective.terms(image, reference, config.weights) | objective.weighted(moved.terms, config.weights)
        loss, told = objective.total(terms, config.weights), {}
        if stress is not None:
            penalty, told = stress(moved.shape)
            self.balance = self.balance or self.balanced(penalty, adam)
            loss = loss + config.stress_weight * self.balance * penalty
        loss.backward()
        rate = config.learning_rate * _schedule(index, config.iterations)
        adam.step(rate, self.relief.rates(index / config.iterations))
        return {
            "loss": float(loss.detach()),
            "gradient_scale": adam.scale,
            **{name: float(value.detach()) for name, value in terms.items()},
            **told,
        }

    def balanced(self, penalty: Tensor, adam: UniformAdam) -> float:
        """The factor that makes the gradient of ``penalty`` as large as those of the appearance were in stage one, so
        that one weight does for all objects."""
        import torch

        from genmf_mi.geometry.mesh import percentile

        (gradient,) = torch.autograd.grad(penalty, self.relief.latent, retain_graph=True)
        return adam.scale / max(float(percentile(gradient[self.relief.blocks[0]].abs(), 0.99)), 1e-12)

    def verify(self, names: Collection[str]) -> None:
        """Simulate the part before, without stage two and after, as far as they are named, for the report."""
        from genmf_mi.stress.report import verification as verdict

        piece, shapes = self.piece, {"before": (self.piece.vertices, self.piece.faces)}
        if self.fork and "unconstrained" in names:
            self.without_stress = shapes["unconstrained"] = self.unconstrained()
        shapes["after"] = self.relief.surface(self.reached)
        shapes = {name: shape for name, shape in shapes.items() if name in names}
        self.verdict = verdict.judge(shapes, piece.frame, self.listener.say)

    def unconstrained(self) -> tuple[np.ndarray, np.ndarray]:
        """Vertices and faces that the part would have without stage two: stage one carried on to the end."""
        adam = self.optimiser()
        self.restore(self.fork, adam)
        for index, _, values in self.steps(int(self.fork["iteration"]), adam, constrained=False):
            self.listener.iteration(index, self.config.iterations, values)
        return self.relief.surface(self.relief.reached())

    def look(self, index: int) -> tuple:
        """The view of iteration ``index`` and what should be seen from it, a function of the seed alone."""
        from genmf_mi.render.scene import View

        piece, config = self.piece, self.config
        views = piece.reference.views
        order = np.random.default_rng([config.seed, index // len(views)]).permutation(len(views))
        view = views[order[index % len(views)]]
        if not piece.reference.pictures:  # a picture shows one view under one light
            rng = np.random.default_rng([config.seed, index, 1])
            azimuth, elevation = rng.uniform(-1, 1, 2) * config.view_jitter
            turn = rng.uniform(-1, 1, 2) * config.light_jitter
            view = View(view.azimuth + azimuth, view.elevation + elevation, tuple(turn))
        return view, piece.reference.look([view], seed=index)

    def state(self, iteration: int, adam: UniformAdam) -> dict[str, np.ndarray]:
        """Copies of all that the next iteration depends on."""
        tensors = {"latent": self.relief.latent.detach(), "first": adam.first, "second": adam.second}
        return {
            "iteration": np.array(iteration),
            "steps": np.array(adam.steps),
            "balance": np.array(self.balance),
            **{f"fork_{name}": value for name, value in self.fork.items()},
            **{name: tensor.cpu().numpy().copy() for name, tensor in tensors.items()},
        }

    def restore(self, state: dict[str, np.ndarray], adam: UniformAdam) -> None:
        """Go back to a :meth:`state`. Raises :class:`ConfigError` for that of another mesh."""
        import torch

        latent = self.relief.latent
        if state["latent"].shape != tuple(latent.shape):
            raise ConfigError(
                "the checkpoint belongs to another mesh: was the asset changed since? Start again with --force."
            )
        with torch.no_grad():
            for tensor, name in ((latent, "latent"), (adam.first, "first"), (adam.second, "second")):
                tensor.copy_(torch.as_tensor(state[name]))
        adam.steps, self.balance = int(state["steps"]), float(state["balance"])
        self.fork = {k.removeprefix("fork_"): v for k, v in state.items() if k.startswith("fork_")} or self.fork

    def finish(self, run: Run | None, seconds: dict, started: float, interrupted: bool, save_exr: bool) -> Result:
        """Untangle, measure, write."""
        from genmf_mi.mesh import meshlab
        from genmf_mi.pipeline import results

        self.listener.say("checking for self-intersections")
        refined = self.relief.finished(self.reached, meshlab.self_intersections)
        seconds["untangle"] = self.lap()
        return results.conclude(self, run, refined, seconds, started, interrupted, save_exr)


def _schedule(index: int, count: int) -> float:
    """Share of the learning rate at iteration ``index``: a short rise, a plateau, a fall to a tenth."""
    rise = min(1.0, (index + 1) / WARM_UP)
    fall = min(1.0, (count - index) / (COOL_DOWN * count))
    return rise * max(0.1, fall)

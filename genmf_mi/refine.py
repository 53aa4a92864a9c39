"""The refinement, from top to bottom: prepare, start, optimise in two stages, untangle, judge, write.

import genmf_mi

result = genmf_mi.refine("bus.glb", genmf_mi.RefineConfig(size_mm=80))
result.vertices_mm, result.faces, result.metrics["after"]["lpips_alex"]
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from genmf_mi.config import RefineConfig
from genmf_mi.errors import ConfigError
from genmf_mi.run import Run

if TYPE_CHECKING:
    from genmf_mi.asset import Asset
    from genmf_mi.geometry.mesh import Relief, UniformAdam
    from genmf_mi.prepare import Workpiece

CHECKPOINT_EVERY = 25
"""Iterations between checkpoints."""
WARM_UP, COOL_DOWN = 10, 0.4
"""Iterations over which the step grows to its full size, and the share of all iterations over which it shrinks
again."""

Penalty = Callable[[Any], dict[str, Any]]
"""Stage two: from the vertices ``[V,3]`` (torch, normalised frame) to named, weighted terms that join the loss."""


class Listener:
    """What a caller may want to hear while a refinement runs; this one hears nothing."""

    def say(self, text: str) -> None:
        """A new step has begun."""

    def iteration(self, index: int, count: int, terms: dict[str, float]) -> None:
        """Iteration ``index`` of ``count`` is done; its loss terms."""


@dataclass(frozen=True)
class Result:
    """A refined part.

    vertices_mm ``[V,3]``: on the print bed, z up, base on z = 0. vertices ``[V,3]``: in the asset's own units, y up.
    faces ``[F,3]``. rgb ``[V,3]``: linear colour of the original at each vertex. relief_mm ``[V]``: signed, positive
    where raised.
    metrics: as in ``metrics.json``. history: one dict per iteration. out: the folder written to, if any.
    """

    vertices_mm: np.ndarray
    vertices: np.ndarray
    faces: np.ndarray
    rgb: np.ndarray
    relief_mm: np.ndarray
    metrics: dict
    history: list[dict]
    out: Path | None


def refine(
    asset: str | Path | Asset,
    config: RefineConfig | None = None,
    *,
    out: str | Path | None = None,
    scene: str | Path | None = None,
    references: tuple[str, ...] = (),
    stage_two: Penalty | None = None,
    force: bool = False,
    resume: bool = False,
    save_exr: bool = False,
    listener: Listener | None = None,
) -> Result:
    """Turn a textured asset into a one-colour part whose relief shows the texture.

    asset: a file, the name of a bundled sample, or a loaded :class:`genmf_mi.asset.Asset`.
    out: folder for all files; None writes nothing.
    scene: a scene file; the sample's own or ``default.xml`` if None.
    references: images to match instead of the texture, each ``image.png@azimuth,elevation``.
    stage_two: more terms for the second stage, e.g. predicted stress.
    force, resume: replace a run in ``out``, or continue an interrupted one.

    A KeyboardInterrupt ends the optimisation early: the part so far is finished and written, and
    ``metrics["interrupted"]`` is set.

    Raises:
        GenmfError: what the command line prints; see :mod:`genmf_mi.errors`.
    """
    from genmf_mi import prepare, samples, variant, weights
    from genmf_mi import scene as scenes
    from genmf_mi.asset import Asset, load

    config, listener = config or RefineConfig(), listener or Listener()
    seconds, started = {}, time.perf_counter()

    if not isinstance(asset, Asset):
        listener.say("loading")
        asset = load(samples.resolve(asset))
    device = variant.use(config.device)
    weights.require(*config.networks)
    xml = Path(scene) if scene else scenes.find(asset.name)
    run = Run.open(out, asset.name, config, force=force, resume=resume) if out else None
    if resume and run is None:
        raise ConfigError("there is nothing to resume without an output folder: give --out.")

    with tempfile.TemporaryDirectory(prefix="genmf-") as folder:
        piece = prepare.prepare(asset, config, xml, Path(folder), references=references, say=listener.say)
        seconds |= piece.seconds
        job = _Job(piece, config, device, listener)
        job.start()
        seconds["displacement"] = job.lap()
        interrupted = False
        if config.method == "relief":
            interrupted = job.optimise(run, resume, stage_two)
        seconds["optimise"] = job.lap()
        return job.finish(run, seconds, started, interrupted, save_exr)


class _Job:
    """The state that the steps of one refinement share."""

    def __init__(self, piece: Workpiece, config: RefineConfig, device: str, listener: Listener) -> None:
        from genmf_mi.evaluate import Judge

        self.piece, self.config, self.device, self.listener = piece, config, device, listener
        listener.say("rendering the references")
        self.judge = Judge(piece.judged_reference, piece.judged_part, piece.reference.views, config.networks)
        self.history: list[dict] = []
        self._clock = time.perf_counter()

    def lap(self) -> float:
        """Seconds since the last call."""
        before, self._clock = self._clock, time.perf_counter()
        return self._clock - before

    def start(self) -> None:
        """Find the best displacement by brightness and put the relief's start there."""
        from genmf_mi import displacement
        from genmf_mi.geometry.broad import broad_smoother
        from genmf_mi.geometry.mesh import Relief
        from genmf_mi.prepare import BROAD_MM

        piece, config = self.piece, self.config
        self.displaced, self.amplitude = displacement.best(piece, self.judge, self.listener.say)
        self.relief = Relief(
            piece.vertices,
            piece.normals,
            piece.faces,
            piece.inward,
            piece.outward,
            piece.sideways,
            smoothing=config.smoothing,
            broad=broad_smoother(piece.vertices, piece.faces, BROAD_MM / piece.frame.mm_per_unit, self.device),
            device=self.device,
        )
        self.offsets = self.displaced[:, None] * piece.normals
        if config.method == "relief":
            self.relief.start_from(displacement.start(piece, self.displaced))

    def optimise(self, run: Run | None, resume: bool, stage_two: Penalty | None) -> bool:
        """Stage one and, where there is a penalty, stage two. Returns whether it was interrupted."""
        from genmf_mi import memory
        from genmf_mi.geometry.mesh import UniformAdam

        relief, config = self.relief, self.config
        adam = UniformAdam(relief.latent, config.learning_rate, floor=config.gradient_floor)
        first = 0
        if resume:
            state, self.history = run.load()
            first = int(state["iteration"])
            _restore(state, relief, adam)
        kept, interrupted, began = _state(first, relief, adam), False, time.perf_counter()
        try:
            for index in range(first, config.iterations):
                stage = 2 if stage_two is not None and index >= config.stage_one_share * config.iterations else 1
                values = self.step(index, adam, stage_two if stage == 2 else None)
                self.history.append(
                    {"iteration": index, "stage": stage, **values, "seconds": round(time.perf_counter() - began, 3)}
                )
                kept = _state(index + 1, relief, adam)
                self.listener.iteration(index, config.iterations, values)
                if (index + 1) % CHECKPOINT_EVERY == 0:
                    memory.give_back()
                    if run:
                        run.save(kept, self.history)
        except KeyboardInterrupt:
            interrupted = True
            # It may have come in the middle of a step
            _restore(kept, relief, adam)
            del self.history[int(kept["iteration"]) :]
            self.listener.say("interrupted: finishing with the relief so far")
        if run:
            run.save(kept, self.history)
        self.offsets = relief.offsets().detach().cpu().numpy().astype(np.float64)
        return interrupted

    def step(self, index: int, adam: UniformAdam, penalty: Penalty | None) -> dict[str, float]:
        """One view, one gradient, one step; returns the loss and its terms."""
        from genmf_mi import bridge
        from genmf_mi.losses import objective

        piece, config = self.piece, self.config
        view, reference = self.look(index)
        vertices = self.relief.vertices()
        image = bridge.render(piece.part, [view], vertices, seed=index)
        terms = objective.terms(image, reference, config.weights)
        loss = objective.total(terms, config.weights)
        for name, value in (penalty(vertices) if penalty else {}).items():
            terms[name], loss = value, loss + value
        loss.backward()
        adam.step(config.learning_rate * _schedule(index, config.iterations))
        return {
            "loss": float(loss.detach()),
            "gradient_scale": adam.scale,
            **{name: float(value.detach()) for name, value in terms.items()},
        }

    def look(self, index: int) -> tuple:
        """The view of iteration ``index`` and what should be seen from it, a function of the seed alone."""
        from genmf_mi.scene import View

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

    def finish(self, run: Run | None, seconds: dict, started: float, interrupted: bool, save_exr: bool) -> Result:
        """Untangle, measure, write."""
        from genmf_mi import meshlab, results
        from genmf_mi.geometry.untangle import untangle

        piece = self.piece
        self.listener.say("checking for self-intersections")
        offsets, tangles = untangle(piece.vertices, piece.faces, self.offsets, meshlab.self_intersections)
        seconds["untangle"] = self.lap()
        return results.conclude(self, run, offsets, tangles, seconds, started, interrupted, save_exr)


def _schedule(index: int, count: int) -> float:
    """Share of the learning rate at iteration ``index``: a short rise, a plateau, a fall to a tenth."""
    rise = min(1.0, (index + 1) / WARM_UP)
    fall = min(1.0, (count - index) / (COOL_DOWN * count))
    return rise * max(0.1, fall)


def _state(iteration: int, relief: Relief, adam: UniformAdam) -> dict[str, np.ndarray]:
    """Copies of all that the next iteration depends on."""
    tensors = {"latent": relief.latent.detach(), "first": adam.first, "second": adam.second}
    return {
        "iteration": np.array(iteration),
        "steps": np.array(adam.steps),
        **{name: tensor.cpu().numpy().copy() for name, tensor in tensors.items()},
    }


def _restore(state: dict[str, np.ndarray], relief: Relief, adam: UniformAdam) -> None:
    import torch

    if state["latent"].shape != tuple(relief.latent.shape):
        raise ConfigError(
            "the checkpoint belongs to another mesh: was the asset changed since? Start again with --force."
        )
    with torch.no_grad():
        for tensor, name in ((relief.latent, "latent"), (adam.first, "first"), (adam.second, "second")):
            tensor.copy_(torch.as_tensor(state[name]))
    adam.steps = int(state["steps"])

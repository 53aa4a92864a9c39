"""Training of the stress network: on the CPU or a GPU, stopped and taken up again at will.

A folder of a training holds::

    config.json          settings, and which samples were used
    log.jsonl            a line per step and per validation
    curves.png           both, drawn
    checkpoint.pt        all that is needed to go on: weights, optimiser, random numbers, best weights so far
    weights.safetensors  the weights that did best on the validation samples (see weights.py)
    metrics.json         their scores, once the training has ended
"""

from __future__ import annotations

import itertools
import json
import math
import time
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from pickle import UnpicklingError

import numpy as np
import torch
from torch import Tensor

from genmf_mi.core.errors import ConfigError, OutputError
from genmf_mi.core.files import atomic, write_text
from genmf_mi.stress.data.reader import StressSamples
from genmf_mi.stress.model import domain, weights
from genmf_mi.stress.model.compute import bfloat16_on, device_of, log_stress, stress
from genmf_mi.stress.model.network import PRESETS, network, to_target, window
from genmf_mi.stress.training import metrics
from genmf_mi.stress.training.config import TrainConfig
from genmf_mi.stress.training.curves import write_curves

CONFIG, LOG, CURVES, CHECKPOINT = "config.json", "log.jsonl", "curves.png", "checkpoint.pt"
WEIGHTS, METRICS = "weights.safetensors", "metrics.json"
CHECKPOINT_EVERY = 50
"""Steps between checkpoints."""
WARM_UP = 0.02
"""Part of the training over which the learning rate rises."""
CLIP = 1.0
"""Largest norm of a gradient."""
FLOOR = 1e-5
"""Added to the error of the coarse stress, in the unit of the loss, before that of the network is divided by it: a
sample counts by the share of the error that the network leaves, but one that is right already hardly counts."""
FORGIVEN = 5
"""Steps in a row without a finite gradient after which the training gives up."""


class Watcher:
    """What may look on; the command line shows a bar."""

    def step(self, step: int, done: float, loss: float) -> None:
        """After each step; ``done`` is the part of the training that is over."""

    def validating(self, item: int, count: int) -> None:
        """After each validation sample."""

    def validated(self, step: int, line: dict) -> None:
        """After each validation."""


def train(
    data: Path,
    out: Path,
    config: TrainConfig,
    *,
    cache: Path | None = None,
    resume: bool = False,
    force: bool = False,
    watcher: Watcher | None = None,
) -> dict:
    """Train on the split ``train`` of a data set, watch the split ``validation``, and return the scores on the latter.

    A training that is killed loses at most :data:`CHECKPOINT_EVERY` steps; with ``resume`` it goes on, and without
    ``minutes`` it ends as if it had not been killed. What is kept are the weights of the best validation.

    Raises:
        ConfigError: no such data, other data or settings than those of the training to resume, no CUDA.
        WeightsError: those to start from are missing, damaged, or of another network or protocol.
        OutputError: ``out`` holds a training already, or nothing to resume, or cannot be written to.
    """
    coarse_mm = PRESETS[config.preset].coarse_mm
    samples = {
        split: StressSamples(
            data, split, augment=split == "train", stride=config.stride, cache=cache, coarse_mm=coarse_mm
        )
        for split in ("train", "validation")
    }
    _claim(out, _record(config, samples), resume, force)
    training = _Training(out, config, samples, watcher or Watcher())
    if resume:
        training.restore()
    training.run()
    return training.finish()


class _Training:
    def __init__(self, out: Path, config: TrainConfig, samples: dict[str, StressSamples], watcher: Watcher) -> None:
        self.out, self.config, self.samples, self.watcher = out, config, samples, watcher
        self.device = device_of(config.device)
        self.bfloat16 = bfloat16_on(self.device, config.precision)
        simulation = samples["train"].settings["simulation"]
        self.simulation = {**simulation, "grid": (simulation["grid"] - 1) // config.stride + 1}
        torch.manual_seed(config.seed)
        self.net = network(config.preset, self.simulation["grid"]).to(self.device)
        if config.start:
            start, _ = weights.load(config.start, preset=config.preset, simulation=self.simulation)
            self.net.load_state_dict(start.state_dict())
        self.optimiser = torch.optim.AdamW(self.net.parameters(), config.rate, weight_decay=config.weight_decay)
        self.step, self.seconds, self.best, self.since_best, self.lost = 0, 0.0, math.inf, 0, 0
        self.best_weights: dict[str, Tensor] = {}
        self.best_scores: dict[str, dict] = {}
        self.log: list[dict] = []

    @property
    def done(self) -> float:
        """The part of the training that is over, by steps or by the clock."""
        by_clock = self.seconds / (60 * self.config.minutes) if self.config.minutes else 0.0
        return min(1.0, max(self.step / self.config.steps, by_clock))

    def run(self) -> None:
        """Learn until the steps or the minutes are over, or nothing gets better any more."""
        start = time.monotonic() - self.seconds
        order = _order(len(self.samples["train"]), self.config.seed, self.step * self.config.batch)
        while self.done < 1.0 and self.since_best < self.config.patience:
            loss, rate = self._learn(order)
            self.step += 1
            self.seconds = time.monotonic() - start
            self.log.append({"step": self.step, "loss": loss, "rate": rate, "seconds": round(self.seconds, 2)})
            self.watcher.step(self.step, self.done, loss)
            if self.step % self.config.validate_every == 0 or self.done >= 1.0:
                self._validate()
                self._save()
                write_curves(self.out / CURVES, self.log)
            elif self.step % CHECKPOINT_EVERY == 0:
                self._save()
            self.seconds = time.monotonic() - start

    def _learn(self, order: Iterator[int]) -> tuple[float, float]:
        """One step; the mean loss of its samples, and the learning rate."""
        rate = self.config.rate * min(1.0, self.done / WARM_UP + 0.01) * 0.5 * (1 + math.cos(math.pi * self.done))
        for group in self.optimiser.param_groups:
            group["lr"] = rate
        self.net.train()
        total = 0.0
        for _ in range(self.config.batch):  # one by one, as no two bodies fill the same box
            phi, true, coarse = self.samples["train"].with_coarse(next(order))
            box = (None, slice(None), *window(phi))
            phi, true, coarse = (None if x is None else x[box].to(self.device) for x in (phi, true, coarse))
            told = log_stress(self.net, phi, self.bfloat16, coarse, self.samples["train"].simulation)
            loss = metrics.masked_mse(told, to_target(true), phi, self.config.tail)
            total += float(loss.detach())
            if coarse is not None:
                # Where a coarse mesh loses a thin wall, its error is a hundred times that of the next sample
                known = metrics.masked_mse(to_target(coarse), to_target(true), phi, self.config.tail)
                loss = loss / (known + FLOOR)
            (loss / self.config.batch).backward()
        norm = float(torch.nn.utils.clip_grad_norm_(self.net.parameters(), CLIP))
        if math.isfinite(total) and math.isfinite(norm):
            self.optimiser.step()
            self.lost = 0
        else:  # a rare overflow of bfloat16 costs its step and no more
            self.lost += 1
            if self.lost == FORGIVEN:
                raise ConfigError(f"the loss is no number any more at step {self.step}; choose a lower --rate.")
        self.optimiser.zero_grad()
        return total / self.config.batch, rate

    def _validate(self) -> None:
        self.net.eval()
        validation = self.samples["validation"]
        known = (validation.with_coarse(item)[2] for item in range(len(validation)))
        rows = metrics.score(
            lambda phi: stress(self.net, phi, self.bfloat16, coarse=next(known), settings=validation.simulation),
            validation,
            lambda item: self.watcher.validating(item, len(validation)),
        )
        scores = metrics.summary(rows)
        line = {f"validation_{key}": scores["all"][key] for key in ("loss", "mae", "iou", "relief")}
        self.log.append({"step": self.step, **line})
        self.since_best += 1
        if line["validation_loss"] < self.best:
            self.best, self.since_best, self.best_scores = line["validation_loss"], 0, scores
            self.best_weights = {name: value.detach().cpu().clone() for name, value in self.net.state_dict().items()}
        self.watcher.validated(self.step, line)

    def _save(self) -> None:
        state = {name: getattr(self, name) for name in _STATE}
        state |= {name: getattr(self, name).state_dict() for name in ("net", "optimiser")}
        with atomic(self.out / CHECKPOINT) as path:
            torch.save({**state, "random": torch.get_rng_state()}, path)
        write_text(self.out / LOG, "".join(json.dumps(line) + "\n" for line in self.log))

    def restore(self) -> None:
        """Go back to the checkpoint. Raises :class:`OutputError` if it is damaged."""
        try:
            state = torch.load(self.out / CHECKPOINT, map_location="cpu", weights_only=True)
            for name in ("net", "optimiser"):
                getattr(self, name).load_state_dict(state[name])
            for name in _STATE:
                setattr(self, name, state[name])
            torch.set_rng_state(state["random"])
        except (OSError, RuntimeError, KeyError, ValueError, EOFError, UnpicklingError) as error:
            raise OutputError(f"{self.out / CHECKPOINT} is damaged; start again with --force.") from error

    def finish(self) -> dict:
        """Write the best weights and their scores, and drop the checkpoint."""
        self.net.load_state_dict(self.best_weights)
        about = {
            **asdict(self.config),
            "start": self.config.start and weights.digest(self.config.start),
            "steps_made": self.step,
            "samples": {split: len(samples) for split, samples in self.samples.items()},
            "validation": self.best_scores,
            "domain": domain.ranges(self.samples["train"][item][0] for item in range(len(self.samples["train"]))),
        }
        digest = weights.save(self.out / WEIGHTS, self.net, self.config.preset, self.simulation, about)
        result = {"sha256": digest, "seconds": round(self.seconds), **about}
        write_text(self.out / METRICS, json.dumps(result, indent=2) + "\n")
        (self.out / CHECKPOINT).unlink(missing_ok=True)
        return result


_STATE = ("step", "seconds", "best", "since_best", "best_weights", "best_scores", "log")


def _order(count: int, seed: int, start: int) -> Iterator[int]:
    """Samples in an order that is new in each epoch, from the ``start``-th on."""
    for epoch in itertools.count(start // count):
        order = np.random.default_rng([seed, epoch]).permutation(count)
        yield from order[start % count if epoch == start // count else 0 :].tolist()


def _record(config: TrainConfig, samples: dict[str, StressSamples]) -> dict:
    """What must be the same when a training is resumed."""
    return {
        "config": asdict(config),
        "data": samples["train"].settings,
        "samples": {split: [record["index"] for record in s.records] for split, s in samples.items()},
    }


def _claim(out: Path, record: dict, resume: bool, force: bool) -> None:
    there = [name for name in (CHECKPOINT, METRICS) if (out / name).exists()]
    if resume:
        if CHECKPOINT not in there:
            raise OutputError(f"{out} holds no interrupted training; start one without --resume.")
        before = json.loads((out / CONFIG).read_text(encoding="utf-8"))
        free = {"device": None, "precision": None}
        changed = [k for k in record if {**before[k], **free} != {**record[k], **free}]
        if changed:
            raise ConfigError(f"the training in {out} had another {', '.join(changed)}; use the same, or --force.")
        return
    if there and not force:
        state = "an interrupted" if CHECKPOINT in there else "a finished"
        raise OutputError(f"{out} holds {state} training; use --resume, --force to replace it, or another --out.")
    for name in (CHECKPOINT, METRICS, LOG, CURVES, WEIGHTS):
        (out / name).unlink(missing_ok=True)
    write_text(out / CONFIG, json.dumps(record, indent=1) + "\n")

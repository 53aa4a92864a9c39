"""Training of the stress network: on the CPU or a GPU, interrupted and resumed at will.

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
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from pickle import UnpicklingError

import numpy as np
import torch
from torch import Tensor

from genmf_mi.core.errors import ConfigError, OutputError
from genmf_mi.core.files import atomic, claim_folder, write_text
from genmf_mi.core.progress import Progress
from genmf_mi.core.timer import Timer
from genmf_mi.stress.data.reader import StressSamples
from genmf_mi.stress.model import domain, weights
from genmf_mi.stress.model.compute import bfloat16_on, device_of, log_stress, stress
from genmf_mi.stress.model.network import PRESETS, build_network, crop_box, to_target
from genmf_mi.stress.training import metrics
from genmf_mi.stress.training.config import TrainConfig
from genmf_mi.stress.training.curves import write_curves

CONFIG, LOG, CURVES, CHECKPOINT = "config.json", "log.jsonl", "curves.png", "checkpoint.pt"
WEIGHTS, METRICS = "weights.safetensors", "metrics.json"
CHECKPOINT_EVERY = 50
"""Steps between checkpoints."""
WARM_UP = 0.02
"""Share of the training over which the learning rate rises."""
MAX_GRADIENT_NORM = 1.0
"""Longer gradients are clipped to this."""
ERROR_FLOOR = 1e-5
"""Added to the error of the coarse stress, in the unit of the loss, before that of the network is divided by it: a
sample counts by the share of the error that the network leaves, but one that is right already hardly counts."""
MAX_NONFINITE_STEPS = 5
"""Steps in a row without a finite gradient after which the training gives up."""


def train(
    data: Path,
    out: Path,
    config: TrainConfig,
    *,
    cache: Path | None = None,
    resume: bool = False,
    force: bool = False,
    progress: Progress | None = None,
) -> dict:
    """Train on the split ``train`` of a data set, watch the split ``validation``, and return the scores on the latter.

    A training that is killed loses at most :data:`CHECKPOINT_EVERY` steps; with ``resume`` it goes on, and without
    ``minutes`` it ends as if it had not been killed. The result are the weights of the best validation.

    Args:
        data: folder of samples. out: folder of the training.
        cache: see :class:`StressSamples`.
        resume: continue the training in ``out``. force: replace it.

    Returns:
        What ``metrics.json`` holds.

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
    trainer = Trainer(out, config, samples, progress)
    if resume:
        trainer.restore()
    trainer.run()
    return trainer.finish()


class Trainer:
    """One training: the network, its optimiser, and what it has come to; see :func:`train`."""

    def __init__(
        self, out: Path, config: TrainConfig, samples: dict[str, StressSamples], progress: Progress | None = None
    ) -> None:
        self.out, self.config, self.samples, self.progress = out, config, samples, progress or Progress()
        self.device = device_of(config.device)
        self.bfloat16 = bfloat16_on(self.device, config.precision)
        simulation = samples["train"].settings["simulation"]
        self.simulation = {**simulation, "grid": (simulation["grid"] - 1) // config.stride + 1}
        self.settings = weights.settings_of(self.simulation)
        torch.manual_seed(config.seed)
        self.net = build_network(config.preset, self.settings.grid).to(self.device)
        if config.start:
            start, _ = weights.load(config.start, preset=config.preset, simulation=self.simulation)
            self.net.load_state_dict(start.state_dict())
        self.optimiser = torch.optim.AdamW(
            self.net.parameters(), config.rate, weight_decay=config.weight_decay, fused=True
        )
        self.step, self.seconds, self.nonfinite_steps = 0, 0.0, 0
        self.best, self.since_best = math.inf, 0
        self.best_weights: dict[str, Tensor] = {}
        self.best_scores: dict[str, dict] = {}
        self.log: list[dict] = []

    @property
    def done(self) -> float:
        """The share of the training that is over, by steps or by the clock."""
        by_clock = self.seconds / (60 * self.config.minutes) if self.config.minutes else 0.0
        return min(1.0, max(self.step / self.config.steps, by_clock))

    def run(self) -> None:
        """Train until the steps or the minutes are over, or nothing gets better any more."""
        timer, before = Timer(), self.seconds
        order = _order(len(self.samples["train"]), self.config.seed, self.step * self.config.batch)
        self.progress.stage("training")
        while self.done < 1.0 and self.since_best < self.config.patience:
            loss, rate = self._optimise(order)
            self.step += 1
            self.seconds = before + timer.total
            self.log.append({"step": self.step, "loss": loss, "rate": rate, "seconds": round(self.seconds, 2)})
            # Of a training that the clock ends, the number of steps is estimated from the time so far
            self.progress.advance(self.step, round(self.step / self.done), {"loss": loss, **self._last_validation()})
            if self.step % self.config.validate_every == 0 or self.done >= 1.0:
                self._validate()
                self._save()
                write_curves(self.out / CURVES, self.log)
                self.progress.stage("training")
            elif self.step % CHECKPOINT_EVERY == 0:
                self._save()
            self.seconds = before + timer.total

    def _optimise(self, order: Iterator[int]) -> tuple[float, float]:
        """One step; the mean loss of its samples, and the learning rate."""
        rate = self.config.rate * min(1.0, self.done / WARM_UP + 0.01) * 0.5 * (1 + math.cos(math.pi * self.done))
        for group in self.optimiser.param_groups:
            group["lr"] = rate
        self.net.train()
        total = 0.0
        for _ in range(self.config.batch):  # one by one, as no two bodies fill the same box
            loss, objective = self._loss(next(order))
            total += float(loss.detach())
            (objective / self.config.batch).backward()
        norm = float(torch.nn.utils.clip_grad_norm_(self.net.parameters(), MAX_GRADIENT_NORM))
        if math.isfinite(total) and math.isfinite(norm):
            self.optimiser.step()
            self.nonfinite_steps = 0
        else:  # a rare overflow of bfloat16 costs its step and no more
            self.nonfinite_steps += 1
            if self.nonfinite_steps == MAX_NONFINITE_STEPS:
                raise ConfigError(f"the loss is not a finite number any more at step {self.step}; lower --rate.")
        self.optimiser.zero_grad()
        return total / self.config.batch, rate

    def _loss(self, item: int) -> tuple[Tensor, Tensor]:
        """The masked loss of a training sample, and what is minimised: with a coarse stress, the share of its error."""
        phi, true, coarse = self.samples["train"].with_coarse(item)
        crop = (None, slice(None), *crop_box(phi))
        phi, target = phi[crop].to(self.device), to_target(true[crop].to(self.device))
        if coarse is not None:
            coarse = coarse[crop].to(self.device)
        predicted = log_stress(self.net, phi, self.bfloat16, coarse, self.settings)
        loss = metrics.masked_mse(predicted, target, phi, self.config.tail)
        if coarse is None:
            return loss, loss
        # Where a coarse mesh loses a thin wall, its error is a hundred times that of the next sample
        error = metrics.masked_mse(to_target(coarse), target, phi, self.config.tail)
        return loss, loss / (error + ERROR_FLOOR)

    def _validate(self) -> None:
        self.net.eval()
        self.progress.stage("validating")
        scores = metrics.summary(metrics.score(self._predict, self.samples["validation"], self.progress))
        line = {f"validation_{key}": scores["all"][key] for key in ("loss", "mae", "iou", "relief")}
        self.log.append({"step": self.step, **line})
        self.since_best += 1
        if line["validation_loss"] < self.best:
            self.best, self.since_best, self.best_scores = line["validation_loss"], 0, scores
            self.best_weights = {name: value.detach().cpu().clone() for name, value in self.net.state_dict().items()}

    def _predict(self, phi: Tensor, coarse: Tensor | None) -> Tensor:
        return stress(self.net, phi, self.bfloat16, coarse=coarse, settings=self.settings)

    def _last_validation(self) -> dict[str, float]:
        """The figures of the last validation for the progress, none before the first."""
        last = next((line for line in reversed(self.log) if "validation_mae" in line), {})
        return {name: last[name] for name in ("validation_mae", "validation_iou") if name in last}

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
        """Write the best weights and their scores, remove the checkpoint, and return what ``metrics.json`` holds."""
        self.net.load_state_dict(self.best_weights)
        about = {
            **asdict(self.config),
            "start": self.config.start and weights.digest(weights.file_of(self.config.start)),
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
    """Claim the folder; compare the record of a training to resume, or write that of a new one."""
    claim_folder(out, "training", finished=[METRICS], interrupted=[CHECKPOINT], force=force, resume=resume)
    if resume:
        existing = json.loads((out / CONFIG).read_text(encoding="utf-8"))
        free = {"device": None, "precision": None}
        changed = [key for key in record if {**existing[key], **free} != {**record[key], **free}]
        if changed:
            raise ConfigError(f"the training in {out} had another {', '.join(changed)}; use the same, or --force.")
        return
    for name in (CHECKPOINT, METRICS, LOG, CURVES, WEIGHTS):
        (out / name).unlink(missing_ok=True)
    write_text(out / CONFIG, json.dumps(record, indent=1) + "\n")

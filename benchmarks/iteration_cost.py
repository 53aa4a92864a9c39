"""Where the time of a run goes: seconds of its stages, and milliseconds of the parts of an iteration.

In the default preset without the stress stage, in one process, at 60 iterations. The parts are timed from outside, by
a clock around the calls that the loop makes; Dr.Jit works only when a result is needed, so that each image is charged
to the call that asks for it.
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any
from unittest.mock import patch

import numpy as np
import torch

import genmf_mi
from benchmarks import record
from benchmarks.inputs import Inputs
from genmf_mi.core.config import PRESETS
from genmf_mi.geometry.mesh import MeshParameterization
from genmf_mi.geometry.uniform_adam import UniformAdam
from genmf_mi.losses import objective
from genmf_mi.render import bridge
from genmf_mi.render.target import Reference

ITERATIONS, WARM_UP = 60, 6
"""The first iterations compile kernels and do not count."""
PARTS: tuple[tuple[str, Any, str], ...] = (
    ("geometry", MeshParameterization, "geometry"),
    ("reference", Reference, "render"),
    ("part", bridge, "render"),
    ("losses", objective, "terms"),
    ("backward", torch.Tensor, "backward"),
    ("step", UniformAdam, "step"),
)
"""Name, where it is, and the call that is timed; the part's render does not contain the reference's."""


def main(inputs: Inputs) -> None:
    """Time the stages and the iterations of one run.

    Args:
        inputs: What all benchmarks have in common; this one reads the first of --assets.
    """
    (asset, *_) = inputs.asset_files(("hunyuan_bus",))
    config = replace(PRESETS["default"], stress=False, iterations=ITERATIONS)
    with timed() as calls:
        result = genmf_mi.refine(asset, config)
    iteration = np.diff([record["seconds"] for record in result.history])[WARM_UP:]
    row = {
        "asset": asset.stem,
        "faces": len(result.faces),
        "seconds": {name: round(value, 2) for name, value in result.metrics["seconds"].items()},
        "milliseconds_per_iteration": round(1000 * float(iteration.mean()), 1),
        "of_these": {name: round(1000 * float(np.mean(calls[name][WARM_UP:ITERATIONS])), 1) for name, _, _ in PARTS},
    }
    print(row, flush=True)
    record.write("iteration_cost", row)


@contextmanager
def timed() -> Iterator[dict[str, list[float]]]:
    """While it lasts, the seconds of every call of the :data:`PARTS` that an iteration makes, by name."""
    calls: dict[str, list[float]] = defaultdict(list)
    within: list[str] = []

    def watched(name: str, call: Callable[..., Any]) -> Callable[..., Any]:
        def timer(*arguments: Any, **options: Any) -> Any:
            if within:  # the reference renders through the same call as the part
                return call(*arguments, **options)
            within.append(name)
            start = time.perf_counter()
            try:
                return call(*arguments, **options)
            finally:
                within.pop()
                if torch.is_grad_enabled():  # neither scores nor pictures
                    calls[name].append(time.perf_counter() - start)

        return timer

    patches = [patch.object(place, name, watched(part, getattr(place, name))) for part, place, name in PARTS]
    for each in patches:
        each.start()
    try:
        yield calls
    finally:
        for each in patches:
            each.stop()

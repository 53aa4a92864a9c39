"""CPU and wall seconds of FlexiCubes at 129³, forward and backward to Φ, the deformation and the weights.

The shapes are a ball, and a gyroid shell cut by that ball, whose surface is six times as large. Each is extracted with
the signs of Φ as in the call before, so that the topology is reused, and with the topology discarded before each call.
Wall seconds are those of a machine that others may share.
"""

from __future__ import annotations

import time

import numpy as np
import torch
from torch import Tensor

from benchmarks import record
from benchmarks.inputs import Inputs
from genmf_mi.core.timer import Timer
from genmf_mi.sdf.flexicubes import WEIGHTS, FlexiCubes

SAMPLES, ROUNDS = 129, 5


def main(inputs: Inputs) -> None:
    """Time FlexiCubes with one thread and with two.

    Args:
        inputs: What all benchmarks have in common; this one reads none of them.
    """
    rows, threads_before = [], torch.get_num_threads()
    for threads in (1, 2):
        torch.set_num_threads(threads)
        for name, phi in shapes().items():
            for cached in (True, False):
                rows.append({"shape": name, "threads": threads, **row(phi, cached)})
                print(rows[-1], flush=True)
    torch.set_num_threads(threads_before)
    record.write("flexicubes", {"samples_per_axis": SAMPLES, "rows": rows})


def shapes() -> dict[str, Tensor]:
    """Φ ``[129,129,129]`` by name."""
    ticks = torch.linspace(-1, 1, SAMPLES)
    x, y, z = torch.meshgrid(ticks, ticks, ticks, indexing="ij")
    ball = (x**2 + y**2 + z**2).sqrt() - 0.85
    a, b, c = 20 * x, 20 * y, 20 * z
    gyroid = (a.sin() * b.cos() + b.sin() * c.cos() + c.sin() * a.cos()) / 30
    return {"ball": ball, "gyroid": torch.maximum(ball, gyroid.abs() - 0.02)}


def row(phi: Tensor, cached: bool) -> dict:
    """Medians over the rounds; ``cached``: keep the topology of the call before."""
    extract = FlexiCubes()
    parameters = [phi.clone(), torch.zeros(*phi.shape, 3), torch.zeros((SAMPLES - 1) ** 3, WEIGHTS)]
    for parameter in parameters:
        parameter.requires_grad_(True)
    seconds, faces = [], 0
    for turn in range(ROUNDS + 1):
        for parameter in parameters:
            parameter.grad = None
        if not cached:
            extract.topology = None
        start, timer = time.process_time(), Timer()
        surface = extract(*parameters)
        middle, faces = time.process_time(), len(surface.faces)
        (surface.vertices.square().sum() + surface.deviation.mean()).backward()
        if turn:  # the first builds the tables
            seconds.append((middle - start, time.process_time() - middle, timer.total))
    median = [round(float(value), 3) for value in np.median(seconds, axis=0)]
    return {
        "signs": "as before" if cached else "new",
        "faces": faces,
        **dict(zip(("forward_cpu_s", "backward_cpu_s", "wall_s"), median, strict=True)),
    }

"""CPU and wall seconds of FlexiCubes at 129³, forward and backward to Φ, the deformation and the weights.

A ball, and a gyroid shell cut by that ball, whose surface is six times as large. Each with the signs of Φ as in the
call before and with new ones, so that all is found anew. Wall seconds are those of a machine that others may share.
"""

from __future__ import annotations

import time

import numpy as np

from benchmarks import record

SAMPLES, ROUNDS = 129, 5


def main() -> None:
    import torch

    from genmf_mi.sdf.flexicubes import WEIGHTS, FlexiCubes

    ticks = torch.linspace(-1, 1, SAMPLES)
    x, y, z = torch.meshgrid(ticks, ticks, ticks, indexing="ij")
    ball = (x**2 + y**2 + z**2).sqrt() - 0.85
    a, b, c = 20 * x, 20 * y, 20 * z
    gyroid = (a.sin() * b.cos() + b.sin() * c.cos() + c.sin() * a.cos()) / 30
    rows, before = [], torch.get_num_threads()
    for threads in (1, 2):
        torch.set_num_threads(threads)
        for name, phi in (("ball", ball), ("gyroid", torch.maximum(ball, gyroid.abs() - 0.02))):
            for cached in (True, False):
                extract = FlexiCubes()
                parts = [phi.clone(), torch.zeros(*phi.shape, 3), torch.zeros((SAMPLES - 1) ** 3, WEIGHTS)]
                for part in parts:
                    part.requires_grad_(True)
                seconds = []
                for turn in range(ROUNDS + 1):
                    for part in parts:
                        part.grad = None
                    if not cached:
                        extract.topology = None
                    began = time.process_time(), time.perf_counter()
                    surface = extract(*parts)
                    forward = time.process_time()
                    (surface.vertices.square().sum() + surface.deviation.mean()).backward()
                    if turn:  # the first builds the tables
                        ended = time.process_time()
                        seconds.append((forward - began[0], ended - forward, time.perf_counter() - began[1]))
                median = [round(float(value), 3) for value in np.median(seconds, axis=0)]
                rows.append(
                    {
                        "shape": name,
                        "threads": threads,
                        "signs": "as before" if cached else "new",
                        "faces": len(surface.faces),
                        **dict(zip(("forward_cpu_s", "backward_cpu_s", "wall_s"), median, strict=True)),
                    }
                )
                print(rows[-1], flush=True)
    torch.set_num_threads(before)
    record.write("flexicubes", {"samples_per_axis": SAMPLES, "rows": rows})

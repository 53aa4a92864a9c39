"""The stress network: what a pass costs, and how well trained weights do beside what needs no network.

    python -m benchmarks.stress_network cost [--threads 2]
    python -m benchmarks.stress_network scores WEIGHTS --data DIR [--split test] [--cache DIR]

CPU seconds are those of the process, so that other work on the machine counts little.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import torch
import tyro
from tyro.conf import Positional

from benchmarks import record
from genmf_mi.memory import peak_gb
from genmf_mi.stress import baselines, compute, metrics, weights
from genmf_mi.stress.network import PRESETS, Architecture, StressNetwork
from genmf_mi.stress.predictor import Predictor
from genmf_mi.stress.reader import StressSamples

FULL, USUAL = (128, 128, 128), (128, 96, 80)
"""The largest window at 129³, and about the mean one of the data set."""
TRIED = (
    ("compact", PRESETS["compact"], FULL, True),
    ("compact", PRESETS["compact"], FULL, False),
    ("compact", PRESETS["compact"], USUAL, True),
    ("compact", PRESETS["compact"], USUAL, False),
    ("narrower, C = 16", Architecture(16, side=2), USUAL, True),
    ("wider, C = 32", Architecture(32, side=2), USUAL, True),
    ("three poolings", Architecture(24, side=2, poolings=3), USUAL, True),
    ("blocks of 4³, C = 48", Architecture(48, side=4, poolings=3), USUAL, True),
    ("no blocks, C = 8", Architecture(8), USUAL, True),
)


def seconds(work: Callable[[], None], repeats: int = 2) -> float:
    """CPU seconds of the best of some runs, after one that does not count."""
    work()
    best = float("inf")
    for _ in range(repeats):
        start = time.process_time()
        work()
        best = min(best, time.process_time() - start)
    return round(best, 2)


def row(architecture: Architecture, shape: tuple[int, int, int], bfloat16: bool, channels_last: bool = False) -> dict:
    """CPU seconds of a forward pass, with the backward pass to the weights, and to Φ."""
    net = StressNetwork(architecture)
    phi = 0.1 * torch.randn(1, 1, *shape)
    if channels_last:
        net = net.to(memory_format=torch.channels_last_3d)
        phi = phi.contiguous(memory_format=torch.channels_last_3d)

    def passes() -> None:
        compute.log_stress(net, phi, bfloat16).mean().backward()

    @torch.no_grad()
    def forward() -> None:
        compute.log_stress(net, phi, bfloat16)

    result = {
        "parameters": sum(p.numel() for p in net.parameters()),
        "window": list(shape),
        "bfloat16": bfloat16,
        "channels_last": channels_last,
        "forward": seconds(forward),
        "training": seconds(passes),
    }
    net.requires_grad_(False)
    phi.requires_grad_()
    return {**result, "refinement": seconds(passes), "peak_gb": round(peak_gb(), 2)}


def cost(threads: int = 1) -> None:
    """What a pass costs, for the compact network and for others that were tried."""
    torch.set_num_threads(threads)
    able = compute.bfloat16_on(torch.device("cpu"))
    rows = [
        {"network": name, **row(architecture, shape, bfloat16 and able)}
        for name, architecture, shape, bfloat16 in TRIED
    ]
    rows.append({"network": "compact", **row(PRESETS["compact"], USUAL, able, channels_last=True)})
    for line in rows:
        print(line, flush=True)
    record.write(f"stress_network_cost_{threads}", rows)


def scores(
    file: Positional[Path],
    /,
    data: Path,
    split: str = "test",
    cache: Path | None = None,
    fit_on: int = 100,
    threads: int = 1,
) -> None:
    """Scores of a network and of the baselines, by family; the baselines are fitted to training samples of ``data``."""
    torch.set_num_threads(threads)
    predictor = Predictor(file)
    samples = StressSamples(data, split, cache=cache)
    weights.check_simulation(file, predictor.about["simulation"], samples.settings["simulation"])
    training = StressSamples(data, "train", cache=cache)
    training.records = training.records[:: max(1, len(training) // fit_on)]
    table = {
        "constant": metrics.summary(metrics.score(baselines.constant(training), samples)),
        "thickness and curvature": metrics.summary(metrics.score(baselines.pointwise(training), samples)),
    }
    rows = metrics.score(predictor.field, samples)
    table["network"] = metrics.summary(rows)
    for name, families in table.items():
        print(name, {key: round(families["all"][key], 4) for key in ("mae", "iou", "mean")}, flush=True)
    record.write(f"stress_network_{split}", {"sha256": weights.digest(file), "scores": table, "samples": rows})


if __name__ == "__main__":
    tyro.extras.subcommand_cli_from_dict({"cost": cost, "scores": scores})

"""The stress network: what a pass costs, and how well trained weights do beside what needs no network.

    python -m benchmarks.stress_network cost [--threads 2]
    python -m benchmarks.stress_network scores WEIGHTS --data DIR [--finer DIR] [--split test] [--cache DIR]

CPU seconds are those of the process, so that other work on the machine counts little.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
import trimesh
import tyro
from skimage.measure import marching_cubes
from tyro.conf import Positional

from benchmarks import record
from genmf_mi.core.memory import peak_gb
from genmf_mi.stress.data.reader import StressSamples
from genmf_mi.stress.model import compute, weights
from genmf_mi.stress.model.network import PRESETS, Architecture, StressNetwork
from genmf_mi.stress.model.predictor import Predictor
from genmf_mi.stress.training import baselines, metrics
from genmf_mi.stress.training.metrics import Predict

FULL, USUAL = (128, 128, 128), (128, 96, 80)
"""The largest window at 129³, and about the mean one of the data set."""
SIMPLE = (3, 20.0)
"""Largest genus and surface of a simple shape, see :func:`complexity`. Relief alone makes a handle or two."""
TRIED = (
    ("compact", PRESETS["compact"], FULL, True),
    ("compact", PRESETS["compact"], FULL, False),
    ("compact", PRESETS["compact"], USUAL, True),
    ("compact", PRESETS["compact"], USUAL, False),
    ("narrower, C = 16", Architecture(16, block_size=2), USUAL, True),
    ("wider, C = 32", Architecture(32, block_size=2), USUAL, True),
    ("three poolings", Architecture(24, block_size=2, poolings=3), USUAL, True),
    ("blocks of 4³, C = 48", Architecture(48, block_size=4, poolings=3), USUAL, True),
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
    finer: Path | None = None,
    split: str = "test",
    cache: Path | None = None,
    fit_on: int = 100,
    threads: int = 1,
) -> None:
    """Scores of a network and of the baselines, over all samples, by group and by family.

    Args:
        file: Weights.
        data: The data set that they were trained on; the baselines are fitted to ``fit_on`` of its training samples.
        finer: The same samples of ``split``, simulated on finer meshes, to judge all by; how far the fields of ``data``
            are from these is then told too, as the noise of the labels.
        split: Of which samples.
        cache: Folder for decoded samples.
        fit_on: See ``data``.
        threads: Of the CPU.
    """
    torch.set_num_threads(threads)
    predictor = Predictor(file)
    samples, coarse = (StressSamples(folder, split, cache=cache) for folder in (finer or data, data))
    weights.check_simulation(file, predictor.about["simulation"], samples.settings["simulation"])
    both = {r["index"] for r in samples.records} & {r["index"] for r in coarse.records}
    for one in (samples, coarse):
        one.records = [record for record in one.records if record["index"] in both]
    training = StressSamples(data, "train", cache=cache)
    training.records = training.records[:: max(1, len(training) // fit_on)]
    labels = iter(coarse)
    solved = [predictor.coarse(samples[item][0]) for item in range(len(samples))]
    alone, given = iter(solved), iter(solved)
    judged: dict[str, Predict] = {
        "constant": baselines.constant(training),
        "thickness and curvature": baselines.pointwise(training),
        "coarse mesh alone": lambda phi, _: next(alone),
        "network": lambda phi, _: predictor.field(phi, coarse=next(given)),
        "labels": lambda phi, _: next(labels)[1],
    }
    if solved[0] is None:
        del judged["coarse mesh alone"]
    if finer is None:
        del judged["labels"]
    shapes = [complexity(samples[item][0][0].numpy()) for item in range(len(samples))]
    table, rows = {}, {}
    for name, predict in judged.items():
        rows[name] = [row | shape for row, shape in zip(metrics.score(predict, samples), shapes)]
        table[name] = metrics.summary(rows[name])
        for group in ("simple", "complex"):
            members = [row for row in rows[name] if row["group"] == group]
            table[name] |= {group: metrics.summary(members)["all"]} if members else {}
        for group in ("all", "simple", "complex"):
            found = table[name].get(group, {"samples": 0})
            print(name, group, {k: round(v, 4) for k, v in found.items() if v is not None}, flush=True)
    simulation = samples.settings["simulation"]
    record.write(
        f"stress_network_{split}",
        {
            "sha256": weights.digest(file),
            "edge_mm": simulation["edge_mm"],
            "labels_edge_mm": coarse.settings["simulation"]["edge_mm"],
            "scores": table,
            "samples": rows["network"],
        },
    )


def complexity(phi: np.ndarray) -> dict:
    """``genus``, ``surface`` (area times longest side over volume; 6 for a ball) and the ``group`` that they make:
    a shape is simple up to :data:`SIMPLE`.

    phi: ``[n,n,n]``, negative inside.
    """
    vertices, faces, _, _ = marching_cubes(phi, 0.0)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    genus = (2 * mesh.body_count - mesh.euler_number) // 2
    surface = float(mesh.area * np.ptp(vertices, axis=0).max() / abs(mesh.volume))
    simple = genus <= SIMPLE[0] and surface <= SIMPLE[1]
    return {"genus": int(genus), "surface": round(surface, 2), "group": "simple" if simple else "complex"}


if __name__ == "__main__":
    tyro.extras.subcommand_cli_from_dict({"cost": cost, "scores": scores})

"""How well a trained stress network does on samples that it has not seen, beside baselines that need no network."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import numpy as np
import torch
import trimesh
from skimage.measure import marching_cubes
from torch import Tensor

from benchmarks import record
from benchmarks.inputs import Inputs
from genmf_mi.stress.data.reader import StressSamples
from genmf_mi.stress.model import weights
from genmf_mi.stress.model.predictor import Predictor
from genmf_mi.stress.training import baselines, metrics
from genmf_mi.stress.training.metrics import Predict

SIMPLE = (3, 20.0)
"""Largest genus and surface of a simple shape, see :func:`complexity`. Relief alone makes a handle or two."""


def main(
    inputs: Inputs,
    *,
    split: Literal["train", "validation", "test"] = "test",
    cache: Path | None = None,
    fit_on: int = 100,
    threads: int = 1,
) -> None:
    """Score the network and the baselines over all samples, by group and by family.

    Args:
        inputs: What all benchmarks have in common. This one reads --data, which the weights were trained on, --weights
            and --finer: with it all are compared with the finer simulations, and the distance of the labels of --data
            from these is reported too, as the noise of the labels.
        split: Of which samples.
        cache: Folder for decoded samples.
        fit_on: The baselines are fitted to about so many of the training samples.
        threads: Of the CPU.
    """
    torch.set_num_threads(threads)
    data, file = inputs.require("data"), weights.file_of(inputs.weights)
    predictor = Predictor(inputs.weights)
    samples, labels = (StressSamples(folder, split, cache=cache) for folder in (inputs.finer or data, data))
    weights.check_simulation(file, predictor.about["simulation"], samples.settings["simulation"])
    keep_common(samples, labels)
    training = StressSamples(data, "train", cache=cache)
    training.records = training.records[:: max(1, len(training) // fit_on)]

    shapes = [complexity(samples[item][0][0].numpy()) for item in range(len(samples))]
    table, rows = {}, {}
    for name, predict in predictions(predictor, samples, labels if inputs.finer else None, training).items():
        rows[name] = [row | shape for row, shape in zip(metrics.score(predict, samples), shapes, strict=True)]
        table[name] = metrics.summary(rows[name])
        for group in ("simple", "complex"):
            members = [row for row in rows[name] if row["group"] == group]
            table[name] |= {group: metrics.summary(members)["all"]} if members else {}
        for group in ("all", "simple", "complex"):
            means = table[name].get(group, {"samples": 0})
            print(name, group, {k: round(v, 4) for k, v in means.items() if v is not None}, flush=True)
    edge_mm = samples.settings["simulation"]["edge_mm"]
    record.write_entry(
        "stress_network_scores",
        f"{predictor.about['preset']}, {split}, {edge_mm:g} mm",
        {
            "machine": record.machine(),
            "sha256": weights.digest(file),
            "edge_mm": edge_mm,
            "labels_edge_mm": labels.settings["simulation"]["edge_mm"],
            "scores": table,
            "samples": rows["network"],
        },
    )


def keep_common(first: StressSamples, second: StressSamples) -> None:
    """Drop the samples that are not in both."""
    common = {r["index"] for r in first.records} & {r["index"] for r in second.records}
    for samples in (first, second):
        samples.records = [r for r in samples.records if r["index"] in common]


def predictions(
    predictor: Predictor, samples: StressSamples, labels: StressSamples | None, training: StressSamples
) -> dict[str, Predict]:
    """What is compared, by name. Each must be called once per sample and in the order of ``samples``.

    labels: coarser simulations of the same samples, or None. training: what the baselines are fitted to.
    """
    coarse = [predictor.coarse(samples[item][0]) for item in range(len(samples))]
    compared: dict[str, Predict] = {
        "constant": baselines.constant(training),
        "thickness and curvature": baselines.pointwise(training),
    }
    fields = [field for field in coarse if field is not None]
    if fields:
        compared["coarse mesh alone"] = in_order(iter(fields))
    remaining = iter(coarse)
    compared["network"] = lambda phi, _: predictor.field(phi, coarse=next(remaining))
    if labels is not None:
        compared["labels"] = in_order(labels[item][1] for item in range(len(labels)))
    return compared


def in_order(fields: Iterator[Tensor]) -> Predict:
    """A "prediction" that returns the next of ``fields``, whatever it is asked for."""
    return lambda phi, coarse: next(fields)


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

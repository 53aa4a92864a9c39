"""How well a predicted field agrees with a simulated one."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from genmf_mi.core.progress import Progress
from genmf_mi.stress.data.reader import StressSamples
from genmf_mi.stress.fem.statistics import surface_band_depth
from genmf_mi.stress.model.network import to_target

Predict = Callable[[Tensor, Tensor | None], Tensor]
"""Φ and the coarse stress of a sample, ``[1,X,Y,Z]``, to von Mises in MPa, likewise; the coarse stress is None for
samples without (:meth:`StressSamples.with_coarse`)."""
TOP = 0.05
"""Share of a body that counts as its most stressed."""


def masked_mse(predicted: Tensor, target: Tensor, phi: Tensor, tail: float = 0.0) -> Tensor:
    """Weighted mean square difference where Φ ≤ 0, a scalar; all fields are of one shape, any.

    A sample counts 1 + ``tail`` where its target is among the highest 5 % inside, else 1.
    """
    inside = phi <= 0
    square, target = (predicted - target)[inside].square(), target[inside]
    if tail == 0.0:
        return square.mean()
    weight = 1.0 + tail * (target >= target.topk(_top(len(target))).values[-1])
    return (weight * square).sum() / weight.sum()


def mean_absolute_error(predicted: Tensor, true: Tensor, phi: Tensor) -> float:
    """In MPa, over the samples with Φ ≤ 0 of fields of one shape."""
    inside = phi <= 0
    return float((predicted[inside] - true[inside]).abs().mean())


def squares(predicted: Tensor, true: Tensor, phi: Tensor) -> tuple[float, float]:
    """Mean square of the error, and that of what is left without the mean, in MPa² over the samples with Φ ≤ 0: the
    parts of R² = 1 − error / spread."""
    inside = phi <= 0
    field = true[inside]
    return float((predicted[inside] - field).square().mean()), float((field - field.mean()).square().mean())


def top_iou(predicted: Tensor, true: Tensor, phi: Tensor) -> float:
    """Intersection over union of the 5 % of the samples inside that are highest in the one field and in the other."""
    inside = phi <= 0
    count = _top(int(inside.sum()))
    first, second = (set(field[inside].topk(count).indices.tolist()) for field in (predicted, true))
    return len(first & second) / len(first | second)


def _top(count: int) -> int:
    return max(1, round(TOP * count))


def band_mean(stress: Tensor, phi: Tensor, depth: float) -> float:
    """Mean in MPa within ``depth`` of the surface, see :func:`genmf_mi.stress.fem.statistics.surface_band_depth`."""
    return float(stress[(phi <= 0) & (phi >= -depth)].mean())


@torch.no_grad()
def score(predict: Predict, samples: StressSamples, progress: Progress | None = None) -> list[dict]:
    """Scores of each sample.

    Returns:
        One row per sample: ``index, shape, family, relief``; ``loss``, :func:`masked_mse` of log(1 + σ/k); ``iou``;
        ``mae, mean, band, true_band`` in MPa, the last two within 4 mm of the surface; and ``squares``.
    """
    progress, rows, depth = progress or Progress(), [], surface_band_depth(samples.simulation.size_mm)
    for item, record in enumerate(samples.records):
        phi, true, coarse = samples.with_coarse(item)
        predicted = predict(phi, coarse)
        rows.append(
            {
                **{key: record[key] for key in ("index", "shape", "family")},
                "relief": record["relief_mm"] is not None,
                "loss": float(masked_mse(to_target(predicted), to_target(true), phi)),
                "mae": mean_absolute_error(predicted, true, phi),
                "iou": top_iou(predicted, true, phi),
                "squares": squares(predicted, true, phi),
                "mean": float(true[phi <= 0].mean()),
                "band": band_mean(predicted, phi, depth),
                "true_band": band_mean(true, phi, depth),
            }
        )
        progress.advance(item + 1, len(samples))
    return rows


def summary(rows: list[dict]) -> dict[str, dict]:
    """Means over all samples (``all``) and over those of each family.

    ``r2`` is the share of the variance within bodies that is predicted, 1 − Σ error / Σ spread over the samples: of
    each sample by itself it would be ruled by those whose stress is nearly the same everywhere. ``relief`` is what a
    refinement relies on: the correlation between the predicted and the true change of the surface band, as log ratios,
    that relief makes to a shape; None where fewer than three shapes come with and without.
    """
    families = {"all": rows}
    for row in rows:
        families.setdefault(row["family"], []).append(row)
    return {name: _means(members) for name, members in families.items()}


def _means(rows: list[dict]) -> dict:
    means = {key: float(np.mean([row[key] for row in rows])) for key in ("loss", "mae", "iou", "mean")}
    error, spread = np.sum([row["squares"] for row in rows], axis=0)
    pairs: dict[int, dict[bool, dict]] = {}
    for row in rows:
        pairs.setdefault(row["index"] // 2, {})[row["relief"]] = row
    changes = [
        [np.log(pair[True][key] / pair[False][key]) for key in ("band", "true_band")]
        for pair in pairs.values()
        if len(pair) == 2 and min(pair[True]["band"], pair[False]["band"]) > 0
    ]
    enough = len(changes) > 2 and np.ptp(changes, axis=0).min() > 0
    relief = float(np.corrcoef(np.transpose(changes))[0, 1]) if enough else None
    return {"samples": len(rows), **means, "r2": float(1 - error / spread), "relief": relief}

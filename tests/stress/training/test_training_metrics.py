"""The loss and the scores against loops, and each prediction scored with the coarse stress of its own sample."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from stress_samples import write_samples

from genmf_mi.core.frame import Frame
from genmf_mi.stress.data.reader import StressSamples
from genmf_mi.stress.fem.statistics import SURFACE_BAND_MM, surface_band_depth
from genmf_mi.stress.training import baselines, metrics


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_samples(tmp_path_factory.mktemp("data") / "a")


def fields(seed: int = 0) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Predicted and true stress, and Φ, ``[1,6,5,4]``."""
    generator = torch.Generator().manual_seed(seed)
    predicted, true = torch.rand(2, 1, 6, 5, 4, generator=generator)
    return predicted, true, torch.randn(1, 6, 5, 4, generator=generator)


@pytest.mark.parametrize("tail", [0.0, 3.0])
def test_masked_loss_and_scores_against_loops(tail: float) -> None:
    predicted, true, phi = fields()
    inside = [place for place in np.ndindex(*phi.shape) if phi[place] <= 0]
    ranked = sorted(inside, key=lambda p: -float(true[p]))
    top = ranked[: max(1, round(0.05 * len(inside)))]
    assert len(top) == 3
    total = count = difference = 0.0
    for place in inside:
        weight = 1 + tail * (place in top)
        total += weight * float(predicted[place] - true[place]) ** 2
        count += weight
        difference += abs(float(predicted[place] - true[place]))
    assert float(metrics.masked_mse(predicted, true, phi, tail)) == pytest.approx(total / count, rel=1e-5)
    assert metrics.mean_absolute_error(predicted, true, phi) == pytest.approx(difference / len(inside), rel=1e-5)
    ours = set(sorted(inside, key=lambda p: -float(predicted[p]))[:3])
    assert metrics.top_iou(predicted, true, phi) == len(ours & set(top)) / len(ours | set(top))
    assert metrics.top_iou(true, true, phi) == 1.0
    mean = sum(float(true[p]) for p in inside) / len(inside)
    errors = sum(float(predicted[p] - true[p]) ** 2 for p in inside) / len(inside)
    spread = sum((float(true[p]) - mean) ** 2 for p in inside) / len(inside)
    assert metrics.squares(predicted, true, phi) == pytest.approx((errors, spread), rel=1e-5)
    near = [float(true[p]) for p in inside if phi[p] >= -0.5]
    assert metrics.band_mean(true, phi, 0.5) == pytest.approx(np.mean(near), rel=1e-5)


def test_surface_band_is_as_deep_in_millimetres_at_any_size() -> None:
    for size_mm in (50.0, 100.0):
        frame = Frame((0.0, 0.0, 0.0), 1.0, size_mm)
        assert surface_band_depth(size_mm) * frame.mm_per_unit == pytest.approx(SURFACE_BAND_MM)
    assert surface_band_depth(100.0) == pytest.approx(0.076), "what the published scores were computed with"


def test_loss_does_not_see_the_outside() -> None:
    predicted, true, phi = fields()
    predicted.requires_grad_()
    (gradient,) = torch.autograd.grad(metrics.masked_mse(predicted, true, phi, tail=1.0), predicted)
    assert (gradient[phi > 0] == 0).all() and (gradient[phi <= 0] != 0).all()


def test_summary_by_family_and_relief() -> None:
    rows = [
        {
            "index": i,
            "family": "ab"[i > 3],
            "relief": bool(i % 2),
            "loss": 0.0,
            "mae": float(i),
            "iou": 0.5,
            "mean": 1.0,
            "squares": (0.5 * (i == 0), 1.0),
        }
        | {"band": 1 + 0.1 * (i % 2) * i, "true_band": 2 + 0.4 * (i % 2) * i}
        for i in range(8)
    ]
    table = metrics.summary(rows)
    assert table["all"]["samples"] == 8 and table["all"]["mae"] == 3.5 and table["b"]["mae"] == 5.5
    assert table["all"]["r2"] == 1 - 0.5 / 8 and table["a"]["r2"] == 1 - 0.5 / 4 and table["b"]["r2"] == 1
    assert table["all"]["relief"] > 0.99, "the change by relief is predicted in proportion"
    assert table["a"]["relief"] is None


def test_scores_do_not_depend_on_the_order(data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A predictor is given the coarse stress of the sample that it is asked for, whatever came before."""
    monkeypatch.setattr(StressSamples, "coarse", lambda self, item: self.arrays(item)[1] * np.float16(1.5))
    samples = StressSamples(data, coarse_mm=2.5)
    rows = metrics.score(lambda phi, coarse: coarse / 1.5, samples)
    assert max(row["mae"] for row in rows) < 1e-3
    shuffled = StressSamples(data, coarse_mm=2.5)
    shuffled.records = [samples.records[item] for item in (3, 0, 4, 1, 2)]
    again = metrics.score(lambda phi, coarse: coarse / 1.5, shuffled)
    assert sorted(again, key=lambda row: row["index"]) == rows


def test_baselines(data: Path) -> None:
    samples = StressSamples(data)
    mean = float(torch.cat([stress[phi <= 0] for phi, stress in samples]).mean())
    phi, _ = samples[0]
    assert float(baselines.constant(samples)(phi, None).mean()) == pytest.approx(mean, rel=1e-5)
    rows = [metrics.score(p, samples) for p in (baselines.constant(samples), baselines.pointwise(samples))]
    errors = [metrics.summary(r)["all"]["mae"] for r in rows]
    assert errors[1] < 0.3 * errors[0], "depth and height are what this field is made of"


def test_local_thickness() -> None:
    """A slab of 13 samples is 6 cells thick from the middle to either side, wherever one asks."""
    depth = 6.0 - np.abs(np.arange(-8, 9.0))
    depth = np.broadcast_to(depth[:, None, None], (17, 9, 9))
    inside = depth >= 0
    assert np.allclose(baselines.thickness(depth)[inside], 6.0)

"""The network of the package against the solver, at several sizes and of several materials, and as it was published."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

from genmf_mi.stress.fem.simulation import Settings, Simulation, simulate
from genmf_mi.stress.model import domain, weights
from genmf_mi.stress.model.predictor import Predictor, summary

TRAINED = Settings()


def stone() -> trimesh.Trimesh:
    """A shape that no training ever saw."""
    mesh = trimesh.creation.icosphere(subdivisions=4)
    x, y, z = mesh.vertices.T
    mesh.vertices *= (1 + 0.15 * np.sin(3 * x + 1) * np.cos(2 * y) - 0.1 * np.sin(4 * z))[:, None] * [0.5, 1.0, 0.6]
    return mesh


def simulated(settings: Settings) -> Simulation:
    """On a finer mesh than that of the coarse field."""
    return simulate(stone().vertices, stone().faces, replace(settings, edge_mm=0.025 * settings.size_mm))


def test_adds_to_the_coarse_field() -> None:
    packaged, truth = Predictor(), simulated(TRAINED)
    phi = torch.from_numpy(truth.phi)[None]
    coarse = packaged.coarse(phi)
    assert coarse is not None
    predicted, true = packaged.field(phi, coarse=coarse)[phi <= 0], torch.from_numpy(truth.on_grid()[0])[None][phi <= 0]
    assert float((predicted - true).abs().mean() / true.mean()) < 0.04
    assert not torch.allclose(predicted, coarse[phi <= 0], rtol=1e-3)
    assert packaged.about["preset"] == "compact"
    assert domain.out_of_distribution(phi, packaged.about["training"]["domain"]) == []


def test_gives_what_it_gave_when_it_was_published() -> None:
    packaged = Predictor(precision="float32")
    assert packaged.settings == TRAINED and packaged.uses_network and packaged.note == ""
    prediction = packaged.predict(stone().vertices, stone().faces)
    numbers = summary(prediction)
    assert numbers["von_mises_mpa"]["mean"] == pytest.approx(0.45126969, rel=1e-5)
    assert numbers["von_mises_mpa"]["p99_9"] == pytest.approx(1.23374916, rel=1e-4)
    assert numbers["surface_band"]["mean"] == pytest.approx(0.68467140, rel=1e-5)
    assert prediction.warnings == []


def test_without_a_mesh() -> None:
    """The network without the coarse field: in one pass, with derivatives, and as it was published."""
    direct, truth = Predictor("direct", precision="float32"), simulated(TRAINED)
    assert direct.about["preset"] == "direct" and direct.settings == TRAINED and direct.note == ""
    phi = torch.from_numpy(truth.phi)[None].requires_grad_()
    assert direct.coarse(phi) is None
    inside = phi.detach() <= 0
    predicted, true = direct.field(phi)[inside], torch.from_numpy(truth.on_grid()[0])[None][inside]
    assert float((predicted - true).detach().abs().mean() / true.mean()) < 0.2
    assert float(predicted.detach().mean()) == pytest.approx(0.46914622, rel=1e-4)
    gradient = torch.autograd.grad(predicted.mean(), phi)[0]
    assert gradient.isfinite().all() and (gradient != 0).any()


def test_the_model_card_names_the_files() -> None:
    card = (Path(__file__).parents[3] / "docs/model_card.md").read_text(encoding="utf-8")
    for name, digest in weights.PACKAGED.items():
        assert f"`genmf_mi/stress/model/{name}.safetensors`" in card and digest in card


@pytest.mark.parametrize(("size_mm", "material"), [(50.0, "pla"), (100.0, "petg"), (50.0, "petg"), (106.0, "pla")])
def test_follows_size_and_material(size_mm: float, material: str) -> None:
    """The mean within 2 % of the solver's, the field within 4 %; the mean of the training is 10 to 65 % off."""
    settings = Settings(size_mm=size_mm, material=material)
    packaged, truth = Predictor(precision="float32", settings=settings), simulated(settings)
    prediction = packaged.predict(stone().vertices, stone().faces)
    assert prediction.frame.size_mm == size_mm and prediction.settings == settings
    assert packaged.uses_network == (size_mm == 106.0)
    assert prediction.warnings == ([packaged.note] if packaged.note else [])
    inside = truth.phi <= 0
    predicted, true = prediction.von_mises[inside], truth.on_grid()[0][inside]
    assert predicted.mean() == pytest.approx(true.mean(), rel=0.02)
    assert np.abs(predicted - true).mean() < 0.04 * true.mean()

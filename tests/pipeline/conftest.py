"""Fixtures of whole refinements: small pictures for all, and two runs that many tests look at."""

from __future__ import annotations

from dataclasses import replace

import pytest
from toy_runs import COARSE_STRESS, CONFIG, Recorder, Waves, striped_ellipsoid

import genmf_mi
from genmf_mi.assets.asset import Asset


@pytest.fixture(scope="module")
def toy() -> Asset:
    return striped_ellipsoid()


@pytest.fixture(scope="module")
def whole(toy, small_refinements, two_views, tmp_path_factory):
    """An uninterrupted run with all its files, and what its progress was told."""
    recorder = Recorder()
    out = tmp_path_factory.mktemp("run") / "toy"
    result = genmf_mi.refine(toy, replace(CONFIG, score_vgg=True), out=out, scene=two_views, save_exr=True,
                             progress=recorder)  # fmt: skip
    return result, recorder


@pytest.fixture(scope="module")
def twin(toy, small_refinements, two_views):
    """The same once more, without files."""
    return genmf_mi.refine(toy, CONFIG, scene=two_views)


@pytest.fixture
def coarse_verification(coarse_warpage, monkeypatch) -> None:
    from genmf_mi.stress.report import verification

    monkeypatch.setattr(verification, "EDGE_MM", 8.0)


@pytest.fixture
def coarse_stress(monkeypatch) -> None:
    """A stress stage whose meshes have some hundred nodes."""
    monkeypatch.setattr(*COARSE_STRESS)


@pytest.fixture
def waves(monkeypatch) -> type[Waves]:
    """A predictor that costs nothing."""
    from genmf_mi.stress.model import predictor

    monkeypatch.setattr(predictor, "Predictor", Waves)
    monkeypatch.setattr(Waves, "evaluations", 0)
    monkeypatch.setattr(Waves, "asked", None)
    return Waves

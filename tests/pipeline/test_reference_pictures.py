"""A refinement problem from a mesh of one colour and pictures of it."""

from __future__ import annotations

import numpy as np
import pytest
from reference_pictures import ball, picture

from genmf_mi.assets.asset import Asset
from genmf_mi.core.config import RefineConfig
from genmf_mi.core.errors import AssetError
from genmf_mi.pipeline import evaluator
from genmf_mi.pipeline.problem import build_problem
from genmf_mi.render import scene_file, variant
from genmf_mi.render.scene import View


def test_flow_with_an_untextured_mesh(tmp_path, monkeypatch):
    """From a mesh of one colour and two pictures to all that the refinement works on."""
    variant.use("cpu")
    monkeypatch.setattr(evaluator, "RESOLUTION", 64)
    vertices, faces = ball()
    asset = Asset.from_arrays("plain", vertices, faces)
    config = RefineConfig(max_faces=2000, edge_mm=8.0, resolution=64)
    with pytest.raises(AssetError, match="--reference"):
        build_problem(asset, config, scene_file.find("default"), tmp_path)
    path = picture(tmp_path / "a.png", (200, 150), (30, 20, 110, 120))
    pictures = (f"{path}@0,0", f"{path}@90,10")
    problem = build_problem(asset, config, scene_file.find("default"), tmp_path, references=pictures)
    for pair in (problem.training, problem.evaluation):
        assert pair.reference.views == (View(0, 0), View(90, 10))
    assert np.ptp(problem.surface.brightness) < 1e-6
    grey = problem.training.reference.render([View(90, 10)]).grey[0, 0]
    assert grey[32, 16] > 0.95 and grey[32, 48] < 0.3


def test_a_bad_picture_is_refused_before_the_work(tmp_path, monkeypatch):
    from genmf_mi.mesh import solid

    monkeypatch.setattr(solid, "solidify", lambda asset: pytest.fail("the pictures should have been read before"))
    with pytest.raises(AssetError, match="cannot read"):
        build_problem(Asset.from_arrays("plain", *ball()), RefineConfig(), scene_file.find("default"), tmp_path,
                        references=(f"{tmp_path / 'nowhere.png'}@0,0",))  # fmt: skip

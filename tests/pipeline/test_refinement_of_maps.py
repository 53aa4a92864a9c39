"""Refinements of a file whose detail is in its normal map alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bumpy_ball import height, mapped
from toy_runs import CONFIG

import genmf_mi
from genmf_mi.core.errors import AssetError

pytestmark = pytest.mark.usefixtures("small_refinements")


def test_what_the_map_pretends_becomes_relief(two_views, tmp_path):
    """Raised where the known bumps are, sunken between them, though nothing but shading says so."""
    config = replace(CONFIG, iterations=16, max_relief_mm=2.0)
    result = genmf_mi.refine(mapped(tmp_path / "ball.glb", scale=1.0), config, scene=two_views)
    before, after = result.metrics["before"], result.metrics["after"]
    assert after["ssim"] > before["ssim"]
    x, y, z = (result.vertices / np.linalg.norm(result.vertices, axis=1, keepdims=True)).T
    bumps = height(np.arccos(y), np.arctan2(x, z))
    seen = np.abs(bumps) > 0.25 * np.abs(bumps).max()
    assert np.corrcoef(result.relief_mm[seen], bumps[seen])[0, 1] > 0.5


def test_without_the_map_there_is_nothing_to_show(two_views, tmp_path):
    with pytest.raises(AssetError, match=r"no colours but in maps that are left out \(--normal-map"):
        genmf_mi.refine(mapped(tmp_path / "ball.glb"), replace(CONFIG, normal_map=False), scene=two_views)
    with pytest.raises(AssetError, match=r"no colours but in maps that are left out \(--normal-map"):
        genmf_mi.evaluate(tmp_path / "ball.glb", "ball", normal_map=False, scene=two_views)


def test_what_cannot_be_used_is_said(two_views, tmp_path):
    path = mapped(tmp_path / "ball.glb", texCoord=4)
    with pytest.raises(AssetError, match="no texture"):
        genmf_mi.refine(path, CONFIG, scene=two_views)
    assert "TEXCOORD_4" in genmf_mi.load(path).notes[0]

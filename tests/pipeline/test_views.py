"""Which views the iterations see, the preview, and that plain areas stay."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image
from toy_runs import CONFIG, Recorder, ellipsoid

import genmf_mi
from genmf_mi.assets.asset import Asset
from genmf_mi.geometry.plain_areas import PLAIN_CAP_MM
from genmf_mi.pipeline.optimisation import POLAR_ELEVATIONS, POLAR_EVERY, sample_view
from genmf_mi.pipeline.run_folder import PREVIEW
from genmf_mi.render.scene import View


def problem(views: tuple[View, ...], pictures: tuple = ()) -> SimpleNamespace:
    return SimpleNamespace(training=SimpleNamespace(reference=SimpleNamespace(views=views, pictures=pictures)))


class TestSampleView:
    VIEWS = (View(0, 20), View(120, -10), View(240, 20))

    def test_standard_views_equally_often_and_some_from_above_and_below(self):
        config = replace(CONFIG, view_jitter=(0.0, 0.0))
        views = [sample_view(problem(self.VIEWS), config, index) for index in range(24 * POLAR_EVERY)]
        standard = {(view.azimuth, view.elevation): 0 for view in self.VIEWS}
        polar = []
        for view in views:
            if (view.azimuth, view.elevation) in standard:
                standard[view.azimuth, view.elevation] += 1
            else:
                polar.append(view)
        assert len(polar) == 24 and set(standard.values()) == {24 * (POLAR_EVERY - 1) // 3}
        assert sum(view.elevation > 0 for view in polar) == 12
        low, high = POLAR_ELEVATIONS
        assert all(low <= abs(view.elevation) <= high for view in polar)
        assert np.ptp([view.azimuth for view in polar]) > 180

    def test_pictures_are_of_their_views(self):
        views = {sample_view(problem(self.VIEWS, ("picture",)), CONFIG, index) for index in range(3 * POLAR_EVERY)}
        assert views == set(self.VIEWS)


@pytest.mark.usefixtures("small_refinements")
class TestPreview:
    def test_there_while_it_runs_and_gone_afterwards(self, toy, two_views, tmp_path):
        class Watch(Recorder):
            def advance(self, done, total, values=None):
                super().advance(done, total, values)
                if done == 1:
                    self.picture = np.asarray(Image.open(tmp_path / PREVIEW).convert("L"), dtype=float)

        watch = Watch()
        genmf_mi.refine(toy, CONFIG, scene=two_views, out=tmp_path, progress=watch)
        assert not (tmp_path / PREVIEW).exists()
        height, width = watch.picture.shape
        side = height - 34 - 12
        panels = [watch.picture[34:-12, 12 + i * (side + 8) :][:, :side] for i in range(3)]
        assert width == 2 * 12 + 3 * side + 2 * 8
        assert np.abs(panels[1] - panels[2]).mean() > 1, "the start has some relief"


@pytest.mark.usefixtures("small_refinements")
def test_plain_areas_stay(two_views):
    """One half is striped, the other of one colour."""
    vertices, faces = ellipsoid()
    stripes = np.where((vertices[:, 0] > 0) & (np.sin(20 * vertices[:, 1]) > 0), 0.2, 0.7).astype(np.float32)
    asset = Asset.from_arrays("half", vertices, faces, colours=np.repeat(stripes[:, None], 3, axis=1))
    result = genmf_mi.refine(asset, replace(CONFIG, max_faces=20_000, edge_mm=1.5), scene=two_views)
    plain = result.metrics["plain_distortion_mm"]
    assert 0.2 < plain["share"] < 0.6
    assert plain["max"] <= PLAIN_CAP_MM + 0.02
    relief = np.abs(result.relief_mm)
    assert np.percentile(relief[result.vertices[:, 0] > 0.2], 90) > 2 * PLAIN_CAP_MM

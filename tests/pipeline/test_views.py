"""Which views the iterations see, the preview, and that plain areas stay."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image
from toy_runs import CONFIG, Recorder, ellipsoid
from toys import sphere

import genmf_mi
from genmf_mi.assets.asset import Asset
from genmf_mi.core.config import RefineConfig
from genmf_mi.geometry.plain_areas import PLAIN_CAP_MM
from genmf_mi.pipeline.regions import RegionField
from genmf_mi.pipeline.run_folder import PREVIEW
from genmf_mi.pipeline.views import (
    CLOSE_EVERY,
    CLOSE_EVERY_COARSE,
    COARSE_SHARE,
    POLAR_ELEVATIONS,
    POLAR_EVERY,
    ZOOM,
    kind,
    resolution,
    sample_view,
)
from genmf_mi.render.scene import View


def problem(views: tuple[View, ...], pictures: tuple = (), shares: tuple[float, ...] = ()) -> SimpleNamespace:
    """A ball whose only detail is at the tip of +x; with regions, views count by ``shares`` and the tip is flat."""
    _, _, normals = sphere()
    reference = SimpleNamespace(views=views, pictures=pictures)
    part = SimpleNamespace(distance=4.0, half_width=0.25)
    return SimpleNamespace(
        training=SimpleNamespace(reference=reference, part=part),
        surface=SimpleNamespace(vertices=normals, normals=normals, brightness=np.exp(20 * (normals[:, 0] - 1))),
        detail=np.exp(20 * (normals[:, 0] - 1)),
        regions=RegionField(1.0 * (normals[:, 0] < 0), *np.ones((2, len(normals)))) if shares else None,
        region_images=SimpleNamespace(shares=np.array(shares)) if shares else None,
    )


class TestSampleView:
    VIEWS = (View(0, 20), View(120, -10), View(240, 20))

    CONFIG = replace(CONFIG, iterations=400, view_jitter=(10.0, 10.0))

    def views(self, config: RefineConfig = CONFIG) -> list[View]:
        return [sample_view(problem(self.VIEWS), config, index) for index in range(config.iterations)]

    def test_as_often_as_what_they_show_counts(self):
        """A view of flat areas only is not taken, one that counts twice as much twice as often; and close views are not
        of what is flat."""
        toy = problem(self.VIEWS, shares=(1.0, 0.0, 2.0))
        config = replace(self.CONFIG, view_jitter=(0.0, 0.0))
        seen = [(kind(config, i), sample_view(toy, config, i)) for i in range(config.iterations)]
        azimuths = [view.azimuth for which, view in seen if which == "standard"]
        assert set(azimuths) == {0, 240}
        assert azimuths.count(240) == pytest.approx(2 * azimuths.count(0), abs=4)
        assert all(np.sin(np.radians(view.azimuth)) <= 1e-9 for which, view in seen if which == "close")

    def of(self, which: str, config: RefineConfig = CONFIG) -> list[View]:
        return [view for index, view in enumerate(self.views(config)) if kind(config, index) == which]

    def test_standard_views_equally_often(self):
        views = self.of("standard", replace(self.CONFIG, view_jitter=(0.0, 0.0)))
        often = [sum((v.azimuth, v.elevation) == (s.azimuth, s.elevation) for v in views) for s in self.VIEWS]
        assert sum(often) == len(views) and max(often) - min(often) <= 1

    def test_some_from_above_and_below(self):
        polar = self.of("polar")
        assert len(polar) == 400 // POLAR_EVERY and sum(view.elevation > 0 for view in polar) == len(polar) // 2
        low, high = POLAR_ELEVATIONS
        assert all(low <= abs(view.elevation) <= high for view in polar)
        assert np.ptp([view.azimuth for view in polar]) > 180

    def test_close_ones_of_what_is_small(self):
        close = self.of("close")
        coarse = COARSE_SHARE * 400
        assert len(close) == coarse / CLOSE_EVERY_COARSE + (400 - coarse) / CLOSE_EVERY
        assert np.mean([abs(view.azimuth - 90) < 40 for view in close]) > 0.9
        assert all(view.zoom == ZOOM and np.abs(view.centre).max() <= 0.5 - 0.5 / ZOOM for view in close)
        assert all(view.zoom == 1 for which in ("standard", "polar") for view in self.of(which))

    def test_same_again(self):
        assert self.views() == self.views()

    def test_coarse_to_fine(self):
        config = replace(self.CONFIG, resolution=384)
        assert [resolution(config, index) for index in (0, 239, 240, 399)] == [256, 256, 384, 384]
        assert resolution(replace(config, resolution=64), 0) == 64

    def test_pictures_are_of_their_views(self):
        views = {sample_view(problem(self.VIEWS, ("picture",)), CONFIG, index) for index in range(24)}
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
        assert np.abs(panels[1] - panels[2]).mean() > 0.5, "the start has some relief"


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

"""Regions of a part, from the settings to the relief: on meshes and fields, resumed, scored and shown."""

from __future__ import annotations

import json
import os
import re
from dataclasses import replace

import numpy as np
import pytest
import trimesh
import yaml
from toy_runs import CONFIG, TOLERANCE_MM, Recorder, difference_mm
from toys import sphere, stripes

import genmf_mi
from genmf_mi.assets.asset import Asset
from genmf_mi.assets.generators.from_mesh import sdf_from_mesh
from genmf_mi.core.errors import AssetError, ConfigError
from genmf_mi.core.frame import Frame
from genmf_mi.core.regions import Regions, Stroke
from genmf_mi.pipeline import regions
from genmf_mi.pipeline.regions import AssetRegions

pytestmark = pytest.mark.usefixtures("small_refinements")


def dab(kind="flat", radius=45.0, factor=2.0, x=1.0) -> Stroke:
    """On the side of the toy that has this sign of x; 45 mm reach about as far as x = 0.15."""
    return Stroke(kind, [[x, 0, 0]], [[x, 0, 0]], radius, factor)


@pytest.fixture(scope="module")
def painted() -> genmf_mi.RefineConfig:
    return replace(CONFIG, regions=Regions((dab(),)))


@pytest.fixture(scope="module")
def half(toy, small_refinements, two_views, painted, tmp_path_factory):
    """A run with one side flat."""
    out = tmp_path_factory.mktemp("regions") / "toy"
    return genmf_mi.refine(toy, painted, out=out, scene=two_views)


def outside_mm(result, asset, stroke) -> np.ndarray:
    """How far each vertex of a part is outside of a dab, in mm."""
    scale = 100 / np.ptp(asset.vertices, axis=0).max()
    return np.linalg.norm(result.vertices - stroke.points, axis=1) * scale - stroke.radius_mm


class TestField:
    """On a sphere of 100 mm, with the dab at (1, 0, 0)."""

    vertices, faces, normals = sphere(5)
    frame = Frame.of(vertices, 100.0)

    def on(self, *strokes, masks=(), fade=4.0):
        return AssetRegions(strokes, masks, fade).on(self.vertices, self.faces, self.normals, self.frame)

    @property
    def distance(self) -> np.ndarray:
        return 50 * np.linalg.norm(self.vertices - [1, 0, 0], axis=1) - 20

    def test_flat_inside_and_full_beyond_the_fade(self):
        field, edge = self.on(dab(radius=20)), 50 * 0.08
        assert (field.mask[self.distance <= 0] == 0).all() and (field.mask[self.distance > 4 + 2 * edge] == 1).all()
        assert ((field.mask > 0) & (field.mask < 1)).sum() > 50
        assert (field.strength == 1).all() and (field.weight == 1).all()
        touched = (self.distance < 0)[self.faces].any(axis=1)
        assert (field.mask[self.faces[touched]] == 0).all(), "no triangle that reaches in may move"

    def test_no_step_at_the_edge(self):
        field = self.on(dab(radius=20))
        a, b = self.faces[:, 0], self.faces[:, 1]
        length = 50 * np.linalg.norm(self.vertices[a] - self.vertices[b], axis=1)
        assert (np.abs(field.mask[a] - field.mask[b]) / length).max() <= 1 / 4 + 1e-9

    def test_a_mask_fades_as_much(self):
        field = self.on(masks=(lambda points, _: (points[:, 0] < 0.5).astype(float),))
        assert (field.mask[self.vertices[:, 0] > 0.5] == 0).all() and (field.mask == 1).sum() > 5000
        a, b = self.faces[:, 0], self.faces[:, 1]
        length = 50 * np.linalg.norm(self.vertices[a] - self.vertices[b], axis=1)
        assert (np.abs(field.mask[a] - field.mask[b]) / length).max() <= 1 / 4 + 1e-9

    def test_stronger_and_matters(self):
        field = self.on(dab("stronger", 20, 3.0), dab("matters", 20, 2.0, x=-1.0))
        near, far = self.distance < 0, 50 * np.linalg.norm(self.vertices - np.array([-1, 0, 0]), axis=1) < 20
        assert (field.strength[near] == 3).all() and (field.weight[near] == 3).all()
        assert (field.strength[far] == 1).all() and (field.weight[far] == 2).all()
        assert (field.mask == 1).all() and ((field.weight > 1) & (field.weight < 2)).any()

    def test_flat_over_stronger_and_erased(self):
        assert (self.on(dab("stronger", 20, 3.0), dab(radius=20)).cap[self.distance < 0] == 0).all()
        for radius in (20, 21, 22.5, 30):  # not even the outline of what was erased is left
            assert (self.on(dab(radius=20), dab("erase", radius)).mask == 1).all()
            assert (self.on(dab("stronger", 20, 3.0), dab("erase", radius)).cap == 1).all()

    def test_areas(self):
        told = self.on(dab(radius=20), dab("matters", 20, x=-1.0)).areas_cm2(50 * self.vertices, self.faces)
        assert told["whole_cm2"] == pytest.approx(4 * np.pi * 25, rel=0.01)
        assert told["weighted_cm2"] == pytest.approx(np.pi * 2.0**2 * 1.25, rel=0.5)  # with its fade
        assert told["flat_cm2"] == pytest.approx(np.pi * 4, rel=0.5) and told["stronger_cm2"] == 0

    def test_a_factor_that_lifts_the_cap_too_high(self):
        config = genmf_mi.RefineConfig(max_relief_mm=4.0, regions=Regions((dab("stronger", 20, 3.0),)))
        with pytest.raises(ConfigError, match="factor 3 makes the relief 12 mm"):
            regions.of_asset(Asset.from_arrays("ball", self.vertices, self.faces), config)


class TestRun:
    def test_flat_where_it_was_painted(self, half, toy):
        moved, outside = np.abs(half.relief_mm), outside_mm(half, toy, dab())
        assert moved[outside <= 0].max() < 1e-3 and (outside <= 0).sum() > 300
        assert moved[outside > 8].max() > 0.2
        told = half.metrics["regions"]
        assert told["flat_max_relief_mm"] < 1e-3 and 0.2 < told["flat_cm2"] / told["whole_cm2"] < 0.8
        assert told["fade_mm"] == 2

    def test_what_is_flat_does_not_count(self, half, twin):
        """The part before scores better than without regions, as half of its faults are none."""
        for group in (lambda m: m, lambda m: m["unseen"], lambda m: m["paper_alignment"]):
            masked, free = (group(run.metrics)["before"] for run in (half, twin))
            assert masked["lpips_alex"] < 0.9 * free["lpips_alex"] and masked["ssim"] > free["ssim"]

    def test_copies_and_report(self, half, painted):
        assert "regions.json" in os.listdir(half.out)
        assert Regions.read(half.out / "regions.json").to_json() == painted.regions.to_json()
        settings = yaml.safe_load((half.out / "config.yaml").read_text())
        assert settings["regions"] == "regions.json" and "regions" in settings["inputs"]
        text = (half.out / "report.html").read_text(encoding="utf-8")
        assert "Kept flat" in text and len(re.findall("What was painted, azimuth", text)) == 2

    def test_resumed(self, toy, two_views, painted, half, tmp_path):
        """With the regions of the folder, or the same again; others are refused."""
        path, out = tmp_path / "strokes.json", tmp_path / "run"
        path.write_text(painted.regions.to_json())
        config = replace(CONFIG, regions=path)
        genmf_mi.refine(toy, config, out=out, scene=two_views, progress=Recorder(stop=3))
        other = replace(CONFIG, regions=Regions((dab(radius=30.0),)))
        with pytest.raises(ConfigError, match="another content of the regions"):
            genmf_mi.refine(toy, other, out=out, scene=two_views, resume=True)
        path.unlink()
        resumed = genmf_mi.refine(toy, CONFIG, out=out, scene=two_views, resume=True)
        assert difference_mm(resumed, half) < TOLERANCE_MM
        assert json.loads((out / "metrics.json").read_text())["regions"]["flat_cm2"] > 0

    def test_refused_before_the_work(self, toy, two_views, tmp_path):
        for changes, message in (
            ({"regions": tmp_path / "gone.json"}, "cannot read the regions"),
            ({"flat_material": ("glass",)}, "no material"),
            ({"mask": tmp_path / "gone.png"}, "no texture coordinates"),
            ({"regions": Regions((dab(radius=1000.0), dab(radius=1000.0, x=-1.0)))}, "all of the surface"),
        ):
            with pytest.raises(ConfigError, match=message):
                genmf_mi.refine(toy, replace(CONFIG, **changes), scene=two_views)

    def test_all_that_is_free_is_of_one_brightness(self, two_views):
        """The texture is not, and so it is not the texture that is spoken of."""
        vertices, faces, _ = sphere(5)
        texture = np.full((64, 64, 3), 128, np.uint8)
        texture[:, 40::4] = 255
        toy = Asset.from_arrays("half", vertices, faces, uv=vertices[:, :2] / 2 + 0.5, texture=texture)
        striped = Regions((dab(radius=60.0),))
        with pytest.raises(AssetError, match=r"wherever relief is allowed.*--flat-material"):
            genmf_mi.refine(toy, replace(CONFIG, regions=striped), scene=two_views)

    def test_stronger_and_matters(self, toy, two_views, twin, tmp_path):
        strokes = Regions((dab("stronger", 45.0, 2.0), dab("matters", 30.0, 3.0, x=-1.0)))
        result = genmf_mi.refine(toy, replace(CONFIG, regions=strokes), out=tmp_path / "run", scene=two_views)
        moved, outside = np.abs(result.relief_mm), outside_mm(result, toy, dab())
        assert moved[outside < 0].max() > 1.2 * np.abs(twin.relief_mm).max()
        assert moved[outside > 3].max() <= CONFIG.max_relief_mm + 1e-6
        assert moved.max() <= 2 * CONFIG.max_relief_mm + 1e-6
        assert result.metrics["regions"]["weighted_cm2"] > result.metrics["regions"]["stronger_cm2"] > 0
        allowed = f"of {2 * CONFIG.max_relief_mm:g}\N{NO-BREAK SPACE}mm allowed"
        assert allowed in (tmp_path / "run" / "report.html").read_text(encoding="utf-8")


def test_of_a_field(two_views):
    """Φ, its deformation and its weights leave the flat side where it was."""
    ball = trimesh.creation.icosphere(4)
    vertices = np.array(ball.vertices) * (1, 0.8, 0.9)
    asset = Asset.from_arrays("toy", vertices, np.array(ball.faces), colours=stripes(vertices))
    config = replace(CONFIG, max_relief_mm=2.0, regions=Regions((dab(),)))
    result = genmf_mi.refine(sdf_from_mesh(asset, samples=33), config, scene=two_views)
    outside = outside_mm(result, asset, dab())
    assert np.abs(result.relief_mm)[outside <= 0].max() < 0.02 and (outside <= 0).sum() > 100
    assert np.abs(result.relief_mm)[outside > 8].max() > 0.2
    assert result.metrics["regions"]["flat_max_relief_mm"] < 0.02

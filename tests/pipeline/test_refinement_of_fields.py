"""Whole refinements of shapes that are Φ on a grid, in a few iterations on a coarse one."""

from __future__ import annotations

import json
import os
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from toy_runs import Recorder
from toys import egg, painted, stripes

import genmf_mi
from genmf_mi.assets import samples, sources
from genmf_mi.assets.asset import Asset, load
from genmf_mi.assets.generators import files
from genmf_mi.assets.generators.from_mesh import sdf_from_mesh
from genmf_mi.assets.sdf_asset import SdfAsset
from genmf_mi.cli.main import main
from genmf_mi.core.errors import AssetError, OutputError
from genmf_mi.mesh.manifold import is_solid
from genmf_mi.mesh.nearest import distance_to_surface
from genmf_mi.mesh.self_intersections import self_intersections
from genmf_mi.pipeline.checkpoint import Checkpoint
from genmf_mi.pipeline.run_folder import CHECKPOINT
from genmf_mi.render import scene

CONFIG = genmf_mi.RefineConfig(iterations=6, resolution=96, samples=4, score_vgg=False, stress=False,
                               max_relief_mm=2.0, device="cpu")  # fmt: skip
TOLERANCE_MM = 1e-2
"""Between two runs with the same seed, see test_refine.py; where weights move a vertex, a flip of a diagonal adds."""


@pytest.fixture(scope="module")
def shape() -> SdfAsset:
    """A striped egg on 33³ samples, 3.3 mm apart on a part of 100 mm."""
    ball = trimesh.creation.icosphere(4)
    vertices = np.array(ball.vertices) * (1, 0.8, 0.9)
    return sdf_from_mesh(
        Asset.from_arrays("toy", vertices, np.array(ball.faces), colours=stripes(vertices)), samples=33
    )


@pytest.fixture(scope="module", autouse=True)
def _small(small_refinements):
    pass


@pytest.fixture(scope="module")
def whole(shape, two_views, tmp_path_factory):
    return genmf_mi.refine(shape, CONFIG, out=tmp_path_factory.mktemp("run") / "toy", scene=two_views)


def apart_mm(one, other) -> float:
    """The largest distance from a vertex of one to the surface of the other, in mm."""
    return float(distance_to_surface(one.vertices_mm, other.vertices_mm, other.faces).max())


class TestWhole:
    def test_files(self, whole):
        names = {"refined.3mf", "refined.stl", "refined.glb", "before_after.png", "report.html", "metrics.json",
                 "metrics.jsonl", "config.yaml"}  # fmt: skip
        assert set(os.listdir(whole.out)) == names
        for name in ("refined.stl", "refined.3mf"):
            read = trimesh.load(whole.out / name, force="mesh")
            read.merge_vertices(digits_vertex=5)
            assert read.is_watertight and read.volume > 0
        glb = load(whole.out / "refined.glb")
        np.testing.assert_allclose(glb.vertices, whole.vertices, atol=1e-5)
        assert abs(glb.albedo.colours - stripes(glb.vertices)).mean() < 0.1, "colours where they belong"

    def test_solid_within_the_cap(self, whole, shape):
        assert is_solid(whole.vertices, whole.faces)
        assert len(self_intersections(whole.vertices, whole.faces)) == 0
        metrics = whole.metrics
        assert metrics["solid"]["watertight"] and metrics["solid"]["bodies"] == 1
        scale = 100 / np.ptp(shape.surface(training=True)[0], axis=0).max()
        distance = distance_to_surface(whole.vertices, *shape.surface(training=True)) * scale
        assert distance.max() <= CONFIG.max_relief_mm + 1e-6
        assert metrics["relief_mm"]["max"] == pytest.approx(distance.max(), rel=1e-3)
        np.testing.assert_allclose(np.abs(whole.relief_mm), distance, atol=0.05)
        assert distance.max() > 0.3

    def test_metrics(self, whole):
        metrics = whole.metrics
        assert json.loads((whole.out / "metrics.json").read_text()) == json.loads(json.dumps(metrics))
        for block in (metrics, metrics["unseen"]):
            assert set(block) >= {"before", "displacement", "after"}
        assert metrics["solid"]["samples_per_axis"] == 33 and metrics["iterations"] == 6
        terms = set(whole.history[0])
        assert terms >= {"loss", "grey_lpips", "sdf_tv", "l_dev", "flexi_weight_reg"}
        assert {"extract", "optimise", "untangle"} <= set(metrics["seconds"])

    def test_the_loss_falls(self, shape, two_views):
        config = replace(CONFIG, iterations=25, view_jitter=(0.0, 0.0), light_jitter=0.0)
        history = genmf_mi.refine(shape, config, scene=two_views).history
        losses = [line["loss"] for line in history]
        assert np.mean(losses[-6:]) < np.mean(losses[:6])

    def test_interrupted_and_resumed(self, whole, shape, two_views, tmp_path):
        """A closed part at once, and in the end the same as without the break."""
        folder = tmp_path / "run"
        stopped = genmf_mi.refine(shape, CONFIG, out=folder, scene=two_views, progress=Recorder(stop=3))
        assert stopped.metrics["interrupted"] and stopped.metrics["solid"]["watertight"]
        assert Checkpoint.load(folder / CHECKPOINT).iteration == 3
        resumed = genmf_mi.refine(shape, CONFIG, out=folder, scene=two_views, resume=True)
        assert apart_mm(whole, resumed) < TOLERANCE_MM and len(resumed.history) == 6
        assert resumed.metrics["after"]["ssim"] == pytest.approx(whole.metrics["after"]["ssim"], abs=1e-3)

    def test_displacement_alone(self, shape, two_views):
        """Much as on the mesh, as far as a grid of 3 mm can."""
        result = genmf_mi.refine(shape, replace(CONFIG, method="displacement"), scene=two_views)
        metrics = result.metrics
        assert metrics["iterations"] == 0 and metrics["solid"]["watertight"]
        assert metrics["after"]["ssim"] == pytest.approx(metrics["displacement"]["ssim"], abs=0.05)
        assert 0.2 < metrics["relief_mm"]["max"] <= CONFIG.max_relief_mm


@pytest.mark.parametrize("stress_by", ["solver", "network"])
def test_second_stage(shape, two_views, waves, coarse_stress, stress_by):
    """Φ reaches the stress, whose measures reach the history."""
    config = replace(CONFIG, stress=True, stress_by=stress_by, stage_one_share=0.5)
    history = genmf_mi.refine(shape, config, scene=two_views).history
    assert [line["stage"] for line in history] == [1, 1, 1, 2, 2, 2]
    assert all(line["stress_mean"] > 0 for line in history[3:])


class TestSources:
    def test_generators_file(self, shape, two_views, tmp_path, capsys):
        """From the command line, with the colours of a mesh beside it."""
        path = tmp_path / "toy.npz"
        files.save(replace(shape, coloured=None), path)
        mesh = painted(tmp_path / "mesh.ply")
        small = ["--iterations", "1", "--resolution", "96", "--no-stress", "--no-score-vgg", "--quiet"]
        arguments = ["refine", str(path), "--scene", str(two_views), "--out", str(tmp_path / "out"), *small]
        assert main(arguments) != 0
        assert "no colours" in capsys.readouterr().err
        assert main([*arguments, "--textured", mesh]) == 0
        assert json.loads((tmp_path / "out" / "metrics.json").read_text())["asset"] == "toy"

    def test_sample_as_field(self, shape, monkeypatch):
        """NAME_sdf is the sample, converted, with the sample's scene."""
        given = []
        monkeypatch.setattr(
            "genmf_mi.assets.generators.from_mesh.sdf_from_mesh", lambda asset: given.append(asset) or shape
        )
        made = sources.load("leaf_sdf")
        assert isinstance(made, SdfAsset) and made.name == "leaf_sdf" and made.phi is shape.phi
        assert [type(mesh) for mesh in given] == [Asset] and given[0].name == "leaf" and given[0].textured
        assert scene.find("strawberry_sdf").stem in ("strawberry", "strawberry_sdf")
        with pytest.raises(AssetError, match="leaf"):
            sources.load("leave_sdf")

    def test_loaded_objects_pass(self, shape):
        assert sources.load(shape) is shape
        with pytest.raises(AssetError, match="--textured"):
            sources.load(shape, textured="x.glb")

    def test_all_samples_have_a_scene(self):
        assert all(scene.find(f"{name}_sdf").stem != "default" for name in samples.NAMES)

    def test_another_run_in_the_folder(self, whole, shape):
        with pytest.raises(OutputError, match="finished run"):
            genmf_mi.refine(shape, CONFIG, out=whole.out)

    def test_without_colours(self):
        with pytest.raises(AssetError, match="no texture"):
            genmf_mi.refine(sdf_from_mesh(Asset.from_arrays("egg", egg().vertices, egg().faces), samples=33), CONFIG)

"""Whole refinements of a small painted shape: the files and the numbers that they leave."""

from __future__ import annotations

import json
import os
import re
from dataclasses import replace

import igl
import numpy as np
import OpenEXR
import pytest
import trimesh
import yaml
from PIL import Image
from toy_runs import CONFIG
from toys import stripes

from genmf_mi.assets.asset import load
from genmf_mi.mesh.nearest import distance_to_surface
from genmf_mi.stress.fem.following import MEASURES as STRESS_TERMS

OF_FIELDS = {"sdf_tv", "l_dev", "flexi_weight_reg"}
SCORES = {"ssim", "lpips_alex", "lpips_vgg", "g_ssim", "g_lpips"}

pytestmark = pytest.mark.usefixtures("small_refinements")


class TestFiles:
    def test_all_are_there(self, whole):
        names = {"refined.3mf", "refined.stl", "refined.glb", "before_after.png", "report.html", "metrics.json",
                 "metrics.jsonl", "config.yaml", "exr"}  # fmt: skip
        assert set(os.listdir(whole[0].out)) == names

    def test_solids_read_back(self, whole):
        """Closed, in millimetres, on the bed, z up; the GLB in the asset's own frame with its colours."""
        result, _ = whole
        for name in ("refined.stl", "refined.3mf"):
            read = trimesh.load(result.out / name, force="mesh")
            read.merge_vertices(digits_vertex=4)
            assert read.is_watertight and read.volume > 0
            np.testing.assert_allclose(read.bounds[0], result.vertices_mm.min(axis=0), atol=1e-3)
            np.testing.assert_allclose(read.bounds[1], result.vertices_mm.max(axis=0), atol=1e-3)
            assert read.bounds[0, 2] == pytest.approx(0, abs=1e-4)
        glb = load(result.out / "refined.glb")
        np.testing.assert_allclose(glb.vertices, result.vertices, atol=1e-5)
        np.testing.assert_allclose(glb.albedo.colours, result.rgb, atol=1e-4)
        np.testing.assert_allclose(result.rgb[:, 0], stripes(result.vertices)[:, 0], atol=0.66)

    def test_pictures_and_report(self, whole):
        result, _ = whole
        with Image.open(result.out / "before_after.png") as picture:
            assert picture.width > 200 and np.asarray(picture.convert("L")).std() > 10
        text = (result.out / "report.html").read_text(encoding="utf-8")
        assert "toy" in text and len(text) > 50_000
        assert "http://" not in text.replace("http://www.w3.org", "") and 'src="https' not in text

    def test_history(self, whole):
        result, recorder = whole
        lines = [json.loads(line) for line in (result.out / "metrics.jsonl").read_text().splitlines()]
        assert lines == result.history
        assert [line["iteration"] for line in lines] == list(range(6))
        assert [line["stage"] for line in lines] == [1] * 6
        seconds = [line["seconds"] for line in lines]
        assert seconds == sorted(seconds)
        weights = vars(CONFIG.weights)
        for line, (done, count, terms) in zip(lines, recorder.records, strict=True):
            assert (done, count) == (line["iteration"] + 1, 6)
            assert terms == line
            total = sum(weights[name] * value for name, value in terms.items() if name in weights)
            assert line["loss"] == pytest.approx(total, rel=1e-4)
            expected = {name for name, weight in weights.items() if weight > 0} - OF_FIELDS - set(STRESS_TERMS)
            assert set(weights) & set(terms) == expected

    def test_settings(self, whole):
        settings = yaml.safe_load((whole[0].out / "config.yaml").read_text())
        assert set(settings.pop("inputs")) == {"asset", "scene", "references"}
        assert settings == {"asset": "toy", **replace(CONFIG, score_vgg=True).to_dict()}

    def test_the_report_tells_the_time(self, whole):
        text = (whole[0].out / "report.html").read_text(encoding="utf-8")
        tile = text[text.index(">Time<") :][:200]
        assert re.search(r"\d s<", tile), tile

    def test_exr(self, whole):
        """G, D and N of every shape and view, read back by OpenEXR, are what the formats and the scene allow."""
        read = {}
        for shape in ("before", "displacement", "after"):
            folder = whole[0].out / "exr" / shape
            assert sorted(os.listdir(folder)) == ["view_00.exr", "view_01.exr"]
            for path in sorted(folder.iterdir()):
                channels = OpenEXR.File(str(path), separate_channels=True).channels()
                image = {name: channel.pixels for name, channel in channels.items()}
                assert {x.dtype for x in image.values()} == {np.dtype("float32")}
                inside, outside = image["A"] == 1, image["A"] == 0
                assert inside.shape == (64, 64) and inside.sum() > 1000 and outside.sum() > 1000
                assert image["A"].min() >= 0 and image["A"].max() <= 1
                normal = np.stack([image[f"N.{axis}"] for axis in "XYZ"])
                length = np.linalg.norm(normal, axis=0)
                assert length.max() <= 1 + 1e-5 and length[inside].min() > 0.5 and np.median(length[inside]) > 0.98
                assert image["Y"][inside].min() > 0 and 0.3 < image["Y"].max() <= 0.8 + 1e-5
                assert 2 < image["Z"][inside].min() < image["Z"][inside].max() < 7  # about a unit ball, 4.3 away
                assert not any(x[outside].any() for x in image.values())
                read[shape, path.name] = image
        before, after = read["before", "view_00.exr"], read["after", "view_00.exr"]
        assert 0.005 < np.abs(before["Y"] - after["Y"]).mean() < 0.1
        assert 0 < np.median(np.abs(before["Z"] - after["Z"])[before["A"] == 1]) < 0.02  # 1 mm is 0.019
        assert np.abs(before["A"] - after["A"]).mean() < 0.02

    def test_stages_are_announced(self, whole):
        stages = " ".join(whole[1].stages)
        for word in ("loading", "solid", "meshing", "scenes", "displacing", "refining", "scoring", "files"):
            assert word in stages
        assert whole[1].warnings == []


class TestMetrics:
    def test_keys(self, whole):
        result, _ = whole
        assert json.loads((result.out / "metrics.json").read_text()) == json.loads(json.dumps(result.metrics))
        metrics = result.metrics
        for block in (metrics, metrics["unseen"]):
            for row in ("before", "displacement", "after"):
                assert set(block[row]) >= SCORES
                assert all(np.isfinite(value) for value in block[row].values()), row
            assert set(block["paper_alignment"]) == {"before", "displacement", "after"}
            assert block["before"]["outline_iou"] > 0.999 > block["after"]["outline_iou"] > 0.95
        plain = metrics["plain_distortion_mm"]
        assert 0 <= plain["mean"] <= plain["p95"] <= plain["max"] <= CONFIG.max_relief_mm and 0 <= plain["share"] <= 1
        assert set(metrics["relief_mm"]) == {"max", "p99", "mean"}
        assert {"watertight", "bodies", "self_intersections", "volume_mm3"} <= set(metrics["solid"])
        assert metrics["iterations"] == 6 and metrics["interrupted"] is False and metrics["asset"] == "toy"
        steps = {key: value for key, value in metrics["seconds"].items() if key != "total"}
        assert {"solid", "remesh", "scenes", "displacement", "optimise", "evaluate", "write"} <= set(steps)
        assert metrics["seconds"]["total"] == pytest.approx(sum(steps.values()), rel=0.1)
        assert 0.1 < metrics["peak_memory_gb"] < 16
        assert metrics["nonfinite_gradients"] == 0 and metrics["relief_backed_off"] < 0.5

    def test_vgg_is_left_out_on_request(self, twin):
        for block in (twin.metrics, twin.metrics["unseen"]):
            assert block["after"]["lpips_vgg"] is None and block["after"]["lpips_alex"] > 0

    def test_relief(self, whole, toy):
        result, _ = whole
        relief = result.metrics["relief_mm"]
        assert 0.05 < relief["mean"] < relief["p99"] <= relief["max"] <= CONFIG.max_relief_mm
        assert np.abs(result.relief_mm).max() <= relief["max"] + 1e-6
        # Measured anew, against the surface of the asset itself
        longest = np.ptp(toy.vertices, axis=0).max()
        away = distance_to_surface(result.vertices, toy.vertices, toy.faces) * 100 / longest
        remeshed = result.metrics["solid"]["remesh"]["max_deviation"] * 100 / longest
        assert relief["mean"] / 4 < away.mean() and away.max() <= relief["max"] + remeshed + 1e-3
        raised = igl.fast_winding_number(toy.vertices, toy.faces, result.vertices) < 0.5
        firm = np.abs(result.relief_mm) > remeshed + 0.05
        assert (raised == (result.relief_mm > 0))[firm].mean() > 0.95

    def test_solid(self, whole):
        solid = whole[0].metrics["solid"]
        assert solid["watertight"] is True and solid["bodies"] == 1
        assert solid["self_intersections"] <= solid["self_intersections_before"] == 0
        assert solid["self_intersections_asset"] == 0
        part = trimesh.Trimesh(whole[0].vertices_mm, whole[0].faces, process=False)
        assert solid["volume_mm3"] == pytest.approx(part.volume, rel=1e-6)
        assert part.is_watertight and part.extents.max() == pytest.approx(100, abs=2.1)

    def test_detail_appears(self, whole):
        """Six iterations are few, but the displacement that it starts from shows the stripes already."""
        metrics = whole[0].metrics
        for name in ("lpips_alex", "g_lpips", "lpips_vgg"):
            assert metrics["after"][name] < metrics["before"][name]

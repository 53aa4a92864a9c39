"""Whole refinements of a small painted shape, in a few iterations and small pictures."""

from __future__ import annotations

import json
import os
from dataclasses import replace

import igl
import numpy as np
import OpenEXR
import pytest
import torch
import trimesh
import yaml
from PIL import Image

import genmf_mi
from genmf_mi.assets.asset import Asset, load
from genmf_mi.core.errors import AssetError, ConfigError, OutputError, SetupError
from genmf_mi.geometry import mesh
from genmf_mi.mesh import topology
from genmf_mi.pipeline import problem as prepare
from genmf_mi.pipeline.refinement import Listener
from genmf_mi.pipeline.run_folder import CHECKPOINT
from genmf_mi.render import scene, variant
from genmf_mi.stress.fem.simulation import Settings
from genmf_mi.stress.report import verification as verdict

SCORES = {"ssim", "lpips_alex", "lpips_vgg", "g_ssim", "g_lpips"}
OF_FIELDS = {"sdf_tv", "l_dev", "flexi_weight_reg"}
TOLERANCE_MM = 2e-3
"""Between two runs with the same seed. Sums over faces and pixels are taken in any order, so that the last bits of the
gradients differ, and Adam divides small gradients by their own size."""


def ellipsoid() -> tuple[np.ndarray, np.ndarray]:
    ball = trimesh.creation.icosphere(4)
    return np.array(ball.vertices) * (1, 0.8, 0.9), np.array(ball.faces)


def stripes(points: np.ndarray) -> np.ndarray:
    return np.where(np.sin(10 * points[:, 1:2] + 3 * points[:, :1]) > 0, np.float32([0.8, 0.2, 0.2]), np.float32(0.15))


def painted(colours: np.ndarray) -> Asset:
    vertices, faces = ellipsoid()
    return Asset.from_arrays("toy", vertices, faces, colours=colours)


@pytest.fixture(scope="module")
def toy() -> Asset:
    return painted(stripes(ellipsoid()[0]))


@pytest.fixture(scope="module", autouse=True)
def _small(small_refinements):
    pass


CONFIG = genmf_mi.RefineConfig(iterations=6, resolution=96, samples=4, max_faces=6000, edge_mm=3.0, score_vgg=False,
                               stress=False, device="cpu")  # fmt: skip


class Recorder(Listener):
    """Remembers what it hears, and raises ``error`` after an iteration."""

    def __init__(self, stop: int | None = None, error: type[BaseException] = KeyboardInterrupt) -> None:
        self.said, self.heard, self.stop, self.error = [], [], stop, error

    def say(self, text: str) -> None:
        self.said.append(text)

    def iteration(self, index: int, count: int, terms: dict[str, float]) -> None:
        self.heard.append((index, count, terms))
        if index == self.stop:
            raise self.error


@pytest.fixture(scope="module")
def whole(toy, two_views, tmp_path_factory):
    """An uninterrupted run with all its files, and what its listener heard."""
    recorder = Recorder()
    out = tmp_path_factory.mktemp("run") / "toy"
    result = genmf_mi.refine(toy, replace(CONFIG, score_vgg=True), out=out, scene=two_views, save_exr=True,
                             listener=recorder)  # fmt: skip
    return result, recorder


@pytest.fixture(scope="module")
def twin(toy, two_views):
    """The same once more, without files."""
    return genmf_mi.refine(toy, CONFIG, scene=two_views)


def difference_mm(one, other) -> float:
    """Between corresponding vertices, at most."""
    assert np.array_equal(one.faces, other.faces)
    scale = 100 / np.ptp(one.vertices, axis=0).max()
    return float(np.linalg.norm(one.vertices - other.vertices, axis=1).max() * scale)


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
        for line, (index, count, terms) in zip(lines, recorder.heard, strict=True):
            assert (index, count) == (line["iteration"], 6)
            assert terms.items() <= line.items()
            total = sum(weights[name] * value for name, value in terms.items() if name in weights)
            assert line["loss"] == pytest.approx(total, rel=1e-4)
            assert set(weights) & set(terms) == {name for name, weight in weights.items() if weight > 0} - OF_FIELDS

    def test_settings_can_be_used_again(self, whole):
        settings = yaml.safe_load((whole[0].out / "config.yaml").read_text())
        assert settings.pop("asset") == "toy"
        assert genmf_mi.RefineConfig.from_dict(settings) == replace(CONFIG, score_vgg=True)

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

    def test_steps_are_announced(self, whole):
        said = " ".join(whole[1].said)
        for word in ("solid", "meshing", "scenes", "displacing", "scoring", "files"):
            assert word in said


class TestMetrics:
    def test_keys(self, whole):
        result, _ = whole
        assert json.loads((result.out / "metrics.json").read_text()) == json.loads(json.dumps(result.metrics))
        metrics = result.metrics
        for block in (metrics, metrics["unseen"]):
            for row in ("before", "displacement", "after"):
                assert set(block[row]) >= SCORES
                assert all(np.isfinite(value) for value in block[row].values()), row
        assert set(metrics["relief_mm"]) == {"max", "p99", "mean"}
        assert {"watertight", "bodies", "self_intersections", "volume_mm3"} <= set(metrics["solid"])
        assert metrics["iterations"] == 6 and metrics["interrupted"] is False and metrics["asset"] == "toy"
        steps = {key: value for key, value in metrics["seconds"].items() if key != "total"}
        assert {"solid", "remesh", "scenes", "displacement", "optimise", "evaluate", "write"} <= set(steps)
        assert metrics["seconds"]["total"] == pytest.approx(sum(steps.values()), rel=0.1)
        assert 0.1 < metrics["peak_memory_gb"] < 16

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
        away = topology.distance(result.vertices, toy.vertices, toy.faces) * 100 / longest
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
        losses = [line["grey_lpips"] for line in whole[0].history]
        assert min(losses[3:]) < losses[0]


class TestSameTwice:
    def test_same_seed(self, whole, twin):
        assert difference_mm(whole[0], twin) < TOLERANCE_MM
        for name in ("ssim", "g_ssim", "lpips_alex"):
            assert twin.metrics["after"][name] == pytest.approx(whole[0].metrics["after"][name], abs=1e-3)
        assert twin.history[0]["loss"] == pytest.approx(whole[0].history[0]["loss"], rel=1e-4)

    def test_another_seed(self, toy, two_views, twin):
        other = genmf_mi.refine(toy, replace(CONFIG, seed=1), scene=two_views)
        assert difference_mm(other, twin) > 10 * TOLERANCE_MM


class TestInterrupted:
    def test_by_ctrl_c_and_resumed(self, toy, two_views, twin, tmp_path):
        """What there is gets finished and written; the resumed run ends where the uninterrupted one did."""
        stopped = genmf_mi.refine(toy, CONFIG, out=tmp_path / "run", scene=two_views, listener=Recorder(stop=2))
        assert stopped.metrics["interrupted"] is True and stopped.metrics["iterations"] == 3
        assert {"refined.3mf", "report.html", "metrics.json", CHECKPOINT} <= set(os.listdir(tmp_path / "run"))
        assert trimesh.load(tmp_path / "run" / "refined.stl").is_watertight
        assert difference_mm(stopped, twin) > 10 * TOLERANCE_MM
        with pytest.raises(OutputError, match="interrupted run"):
            genmf_mi.refine(toy, CONFIG, out=tmp_path / "run", scene=two_views)

        resumed = genmf_mi.refine(toy, CONFIG, out=tmp_path / "run", scene=two_views, resume=True)
        assert resumed.metrics["interrupted"] is False
        assert [line["iteration"] for line in resumed.history] == list(range(6))
        assert resumed.history[:3] == stopped.history
        assert CHECKPOINT not in os.listdir(tmp_path / "run")
        assert difference_mm(resumed, twin) < TOLERANCE_MM

    def test_by_a_crash_in_the_middle_of_a_step(self, toy, two_views, twin, tmp_path, monkeypatch):
        """Ctrl-C between the two moments of Adam, then a crash: neither leaves a trace in what follows."""
        percentile, calls = mesh.percentile, []

        def interrupted(*arguments):
            calls.append(1)
            if len(calls) == 2 * 3 + 2:  # twice a step; now between its two halves in the fourth
                raise KeyboardInterrupt
            return percentile(*arguments)

        with monkeypatch.context() as patch:
            patch.setattr(mesh, "percentile", interrupted)
            stopped = genmf_mi.refine(toy, CONFIG, out=tmp_path / "run", scene=two_views)
        assert stopped.metrics["iterations"] == 3
        with pytest.raises(RuntimeError):
            genmf_mi.refine(toy, CONFIG, out=tmp_path / "run", scene=two_views, resume=True,
                            listener=Recorder(stop=4, error=RuntimeError))  # fmt: skip
        heard = Recorder()
        resumed = genmf_mi.refine(toy, CONFIG, out=tmp_path / "run", scene=two_views, resume=True, listener=heard)
        assert [index for index, *_ in heard.heard] == [4, 5]  # from the checkpoint after the fourth iteration
        assert [line["iteration"] for line in resumed.history] == list(range(6))
        assert difference_mm(resumed, twin) < TOLERANCE_MM

    def test_the_asset_was_changed_meanwhile(self, toy, two_views, tmp_path):
        genmf_mi.refine(toy, CONFIG, out=tmp_path / "run", scene=two_views, listener=Recorder(stop=0))
        vertices, faces = ellipsoid()
        other = Asset.from_arrays("toy", vertices * (1, 0.5, 1), faces, colours=stripes(vertices))
        with pytest.raises(ConfigError, match="another mesh"):
            genmf_mi.refine(other, CONFIG, out=tmp_path / "run", scene=two_views, resume=True)


class TestNoRelief:
    @pytest.mark.parametrize("noise", [0, 1])
    def test_a_grey_texture_leaves_the_shape_alone(self, two_views, noise):
        """Also with the noise of an 8-bit picture: 99 % of the surface within 0.05 mm."""
        vertices, faces = ellipsoid()
        texture = np.full((64, 64, 3), 128, np.uint8)
        texture += np.random.default_rng(0).integers(0, noise + 1, (64, 64, 1), dtype=np.uint8)
        uv = vertices[:, :2] / 2 + 0.5
        grey = Asset.from_arrays("grey", vertices, faces, uv=uv, texture=texture)
        result = genmf_mi.refine(grey, replace(CONFIG, iterations=10), scene=two_views)
        assert result.metrics["relief_mm"]["p99"] <= 0.05
        assert result.metrics["after"]["ssim"] > 0.99

    def test_a_cap_of_zero(self, toy, two_views):
        result = genmf_mi.refine(toy, replace(CONFIG, iterations=2, max_relief_mm=0.0), scene=two_views)
        assert result.metrics["relief_mm"]["max"] < 1e-6
        assert result.metrics["after"]["ssim"] == pytest.approx(result.metrics["before"]["ssim"], abs=1e-4)


class Waves:
    """Instead of the network: a stress that is high in stripes across x, whatever the shape."""

    settings, looks = Settings(grid=33), 0

    def __init__(self, device: str) -> None:
        pass

    def field(self, phi: torch.Tensor, box: tuple[slice, slice, slice]) -> torch.Tensor:
        Waves.looks += 1
        stripes = 1 + 0.5 * torch.sin(8 * torch.linspace(-1, 1, 33))
        return stripes[:, None, None].expand(phi.shape)


class TestStress:
    CONFIG = replace(CONFIG, stress=True, stress_weight=10.0, stage_one_share=0.5)

    @pytest.fixture(autouse=True)
    def _stub(self, monkeypatch):
        monkeypatch.setattr("genmf_mi.stress.model.predictor.Predictor", Waves)
        monkeypatch.setattr(verdict, "EDGE_MM", 8.0)
        monkeypatch.setattr(Waves, "looks", 0)

    def test_second_stage(self, toy, two_views, twin):
        """From its share on, looked at every other iteration; in the loss, in the history, and in the shape."""
        result = genmf_mi.refine(toy, replace(self.CONFIG, stress_every=2), scene=two_views)
        assert Waves.looks == 1 + 2
        terms = {"stress_mean", "stress_variance", "stress_band", "stress_peak"}
        assert [line["stage"] for line in result.history] == [1, 1, 1, 2, 2, 2]
        assert [terms <= set(line) for line in result.history] == [False] * 3 + [True] * 3
        told = [{name: line[name] for name in terms} for line in result.history[3:]]
        assert told[0] == told[1] != told[2]
        rest = [
            line["loss"] - sum(w * line[name] for name, w in vars(CONFIG.weights).items() if name in line)
            for line in result.history
        ]
        assert rest[:3] == pytest.approx([0] * 3, abs=1e-4)
        factor = [one / (sum(values.values()) - 4) for one, values in zip(rest[3:], told)]
        assert factor[2] == pytest.approx(factor[0], rel=1e-3) and factor[0] > 0, "one balance for all of the stage"
        waves = np.sin(8 * result.vertices[:, 0] * 0.95)
        pulled = result.relief_mm - twin.relief_mm
        assert np.corrcoef(waves, pulled)[0, 1] < -0.2, "out of what is under stress, into what is not"
        assert result.metrics["relief_mm"]["max"] <= CONFIG.max_relief_mm
        assert "stress" not in result.metrics and "unconstrained" not in result.metrics

    def test_resumed_and_verified(self, toy, two_views, twin, tmp_path, monkeypatch):
        """After a crash in stage two it ends where the uninterrupted run does, and knows where it parted."""
        config = replace(self.CONFIG, stress_every=1)
        whole = genmf_mi.refine(toy, config, scene=two_views)
        with pytest.raises(RuntimeError):
            genmf_mi.refine(toy, config, out=tmp_path / "run", scene=two_views,
                            listener=Recorder(stop=4, error=RuntimeError))  # fmt: skip
        with np.load(tmp_path / "run" / CHECKPOINT) as state:
            assert state["balance"] > 0 and int(state["iteration"]) == 4 and int(state["fork_iteration"]) == 3
            assert not np.array_equal(state["latent"], state["fork_latent"])

        judged = {}
        judge = verdict.judge
        monkeypatch.setattr(verdict, "judge", lambda shapes, *rest: judged.update(shapes) or judge(shapes, *rest))
        resumed = genmf_mi.refine(toy, config, out=tmp_path / "run", scene=two_views, resume=True, verify=True)
        assert [line["stage"] for line in resumed.history] == [1, 1, 1, 2, 2, 2]
        assert difference_mm(resumed, whole) < TOLERANCE_MM
        metrics = json.loads((tmp_path / "run" / "metrics.json").read_text())
        stress = metrics["stress"]
        assert set(stress["shapes"]) == {"before", "unconstrained", "after"}
        assert set(stress["ratio"]) == {"unconstrained", "after", "constrained"} and "mean" in stress["remains"]
        apart = (resumed.vertices - twin.vertices) * 100 / np.ptp(twin.vertices, axis=0).max()
        assert np.abs(apart).max() > 10 * TOLERANCE_MM
        after, unconstrained = (judged[name][0] for name in ("after", "unconstrained"))
        simulated = (after - unconstrained) * 100 / np.ptp(unconstrained, axis=0).max()
        np.testing.assert_allclose(simulated, apart, atol=TOLERANCE_MM)
        for name in ("lpips_alex", "ssim"):
            assert metrics["unconstrained"][name] == pytest.approx(twin.metrics["after"][name], abs=1e-3)
        assert set(metrics["unseen"]["unconstrained"]) == set(metrics["after"])
        text = (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
        assert "Thermal stress" in text and "Without stress stage" in text and "predicted stress, surface band" in text

    def test_no_stage_for_thin_walls(self, toy, two_views, twin, monkeypatch):
        """It says so, and gives what there is without."""
        monkeypatch.setattr("genmf_mi.sdf.distance.lost_fraction", lambda *surface: 0.2)
        result = genmf_mi.refine(toy, self.CONFIG, scene=two_views)
        assert Waves.looks == 0 and {line["stage"] for line in result.history} == {1}
        assert "20%" in result.metrics["stress_stage_left_out"]
        assert difference_mm(result, twin) < TOLERANCE_MM

    def test_some_shapes_alone(self, toy, two_views):
        """Nothing is simulated unasked, and without a stress stage there is nothing between before and after."""
        config = replace(CONFIG, iterations=1)
        one = genmf_mi.refine(toy, config, scene=two_views, verify=("after",)).metrics
        two = genmf_mi.refine(toy, config, scene=two_views, verify=True).metrics
        assert set(one["stress"]["shapes"]) == {"after"} and "ratio" not in one["stress"]
        assert set(two["stress"]["shapes"]) == {"before", "after"} and set(two["stress"]["ratio"]) == {"after"}
        means = [metrics["stress"]["shapes"]["after"]["von_mises_mpa"]["mean"] for metrics in (one, two)]
        assert means[0] == pytest.approx(means[1], rel=1e-3)


class TestWays:
    def test_displacement(self, toy, two_views, tmp_path):
        """The baseline alone: it is what the scores of `displacement` stand for."""
        result = genmf_mi.refine(toy, replace(CONFIG, method="displacement"), out=tmp_path / "run", scene=two_views)
        metrics = result.metrics
        assert metrics["iterations"] == 0 and result.history == []
        assert metrics["displacement_amplitude"] in (-0.5, 0.5)
        for name in SCORES - {"lpips_vgg"}:
            assert metrics["after"][name] == pytest.approx(metrics["displacement"][name], abs=1e-3)
        assert 0 < metrics["relief_mm"]["max"] <= CONFIG.max_relief_mm
        bright = stripes(result.vertices).max(axis=1) > 0.5
        raised = result.relief_mm[bright].mean() - result.relief_mm[~bright].mean()
        assert raised * metrics["displacement_amplitude"] > 0
        assert CHECKPOINT not in os.listdir(tmp_path / "run")

    def test_from_pictures(self, two_views, tmp_path):
        """A mesh without colours and one picture: its view is the one that counts, and there are no unseen ones."""
        y, x = np.mgrid[:120, :120] - 59.5
        inside = np.hypot(x / 58, y / 48) < 1
        pixels = np.where((np.sin(y / 5) > 0)[..., None], (230, 60, 60), (60, 60, 60))
        Image.fromarray(np.dstack([pixels, 255 * inside]).astype(np.uint8)).save(tmp_path / "front.png")
        plain = Asset.from_arrays("plain", *ellipsoid())
        with pytest.raises(AssetError, match="--reference"):
            genmf_mi.refine(plain, CONFIG, scene=two_views)
        result = genmf_mi.refine(plain, replace(CONFIG, iterations=3), scene=two_views, out=tmp_path / "run",
                                 references=(f"{tmp_path / 'front.png'}@0,0",))  # fmt: skip
        assert "unseen" not in result.metrics and set(result.metrics["after"]) >= SCORES
        assert result.metrics["relief_mm"]["max"] > 1e-3
        assert (tmp_path / "run" / "report.html").stat().st_size > 50_000

    def test_silhouettes(self, toy, two_views):
        result = genmf_mi.refine(toy, replace(CONFIG, iterations=2, silhouettes=True), scene=two_views)
        assert "teacher_depth" not in result.history[0] and np.isfinite(result.history[-1]["loss"])
        assert result.metrics["solid"]["watertight"]

    def test_without_iterations(self, toy, two_views, tmp_path):
        result = genmf_mi.refine(toy, replace(CONFIG, iterations=0), out=tmp_path / "run", scene=two_views)
        assert result.history == [] and (tmp_path / "run" / "metrics.jsonl").read_text() == ""

    def test_nothing_is_written_unasked(self, toy, two_views, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "scratch"))
        (tmp_path / "scratch").mkdir()
        genmf_mi.refine(toy, replace(CONFIG, iterations=1), scene=two_views)
        assert os.listdir(tmp_path) == ["scratch"] and os.listdir(tmp_path / "scratch") == []

    def test_on_the_gpu(self, toy, two_views, twin):
        if not variant.cuda_available():
            with pytest.raises(SetupError, match="no CUDA device"):
                genmf_mi.refine(toy, replace(CONFIG, device="cuda"), scene=two_views)
            pytest.skip("no CUDA device is visible to both torch and Dr.Jit")
        result = genmf_mi.refine(toy, replace(CONFIG, device="cuda"), scene=two_views)
        variant.use("cpu")
        assert difference_mm(result, twin) < 0.2
        for name in ("ssim", "lpips_alex"):
            assert result.metrics["after"][name] == pytest.approx(twin.metrics["after"][name], abs=5e-3)


class TestRefusedBeforeTheWork:
    @pytest.fixture(autouse=True)
    def _no_work(self, monkeypatch):
        monkeypatch.setattr(prepare, "prepare", lambda *_, **__: pytest.fail("this should have been refused before"))

    def test_a_finished_run(self, toy, tmp_path):
        (tmp_path / "metrics.json").write_text("{}")
        with pytest.raises(OutputError, match="finished run"):
            genmf_mi.refine(toy, CONFIG, out=tmp_path)

    def test_resume_without_a_folder(self, toy):
        with pytest.raises(ConfigError, match="--out"):
            genmf_mi.refine(toy, CONFIG, resume=True)

    def test_folder_that_cannot_be_written(self, toy, tmp_path):
        (tmp_path / "file").touch()
        with pytest.raises(OutputError, match="cannot write"):
            genmf_mi.refine(toy, CONFIG, out=tmp_path / "file")

    def test_no_such_asset(self):
        with pytest.raises(AssetError, match=r"nowhere\.glb"):
            genmf_mi.refine("nowhere.glb", CONFIG)


class TestLocalContrast:
    """What decides how much of the cap an object gets."""

    @staticmethod
    def of(brightness) -> float:
        vertices, faces = ellipsoid()
        return prepare.local_contrast(vertices, faces, brightness(vertices), 0.16)

    def test_one_brightness_has_none(self):
        assert self.of(lambda v: np.full(len(v), 0.7)) == pytest.approx(0, abs=1e-6)

    def test_a_blush_has_little(self):
        assert self.of(lambda v: 0.5 + 0.3 * v[:, 1]) < 0.03

    def test_stripes_have_much(self):
        assert self.of(lambda v: np.where(np.sin(15 * v[:, 1]) > 0, 0.9, 0.2)) > 0.2

    def test_in_proportion(self):
        wave = [self.of(lambda v, a=a: 0.5 + a * np.sin(30 * v[:, 1])) for a in (0.1, 0.2)]
        assert wave[1] == pytest.approx(2 * wave[0], rel=1e-3)


def test_scene_of_a_sample_is_its_own(monkeypatch, toy):
    """A bundled sample brings its views along; `scene` overrides them."""
    asked = []
    monkeypatch.setattr(prepare, "prepare", lambda asset, config, xml, *_, **__: asked.append(xml) or pytest.skip)
    for name, given in (("globe", None), ("toy", None), ("globe", scene.find("leaf"))):
        with pytest.raises(AttributeError):
            genmf_mi.refine(replace(toy, name=name), CONFIG, scene=given)
    assert [path.stem for path in asked] == ["globe", "default", "leaf"]

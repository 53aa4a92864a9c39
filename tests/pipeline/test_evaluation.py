"""The numbers: what equal shapes score, what worse ones lose, and where the unseen views lie."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path

import genmf_mi.scenes
import numpy as np
import pytest
import torch
import trimesh
from skimage.metrics import structural_similarity

import genmf_mi
from genmf_mi.assets.asset import Asset
from genmf_mi.core.config import RefineConfig
from genmf_mi.losses.alignment import Alignment
from genmf_mi.pipeline import evaluation, evaluator
from genmf_mi.pipeline.evaluator import UNSEEN_TURNS, Evaluator, unseen_views
from genmf_mi.pipeline.scoring import ssim
from genmf_mi.render import bridge, scene, scene_file, target, variant
from genmf_mi.render.scene import RenderSettings, View

KEYS = {"ssim", "ssim_mask", "g_ssim", "g_ssim_mask", "lpips_alex", "lpips_mask_alex", "lpips_vgg", "lpips_mask_vgg",
        "g_lpips"}  # fmt: skip
VIEWS = (View(0, 20), View(180, -10))
SETS = {
    path.stem: scene.parse_views(scene.read_defaults(path)["views"])
    for path in sorted(Path(genmf_mi.scenes.__file__).parent.glob("[a-z]*.xml"))
    if not path.stem.endswith("_sdf")
}


def ball(subdivisions: int = 5) -> tuple[np.ndarray, np.ndarray]:
    mesh = trimesh.creation.icosphere(subdivisions)
    directions = np.array(mesh.vertices)
    return directions * (0.85 + 0.1 * np.sin(3 * directions[:, :1] + directions[:, 1:2])), np.array(mesh.faces)


def striped(points: np.ndarray, _normals: np.ndarray | None = None) -> np.ndarray:
    return np.where(np.sin(12 * points[:, 1:2] + 3 * points[:, :1]) > 0, np.float32([0.8, 0.2, 0.2]), np.float32(0.15))


@pytest.fixture(scope="module")
def small():
    """Small pictures in place of the protocol's."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(evaluator, "RESOLUTION", 96)
        patch.setattr(evaluator, "SAMPLES", 4)
        yield


@pytest.fixture(scope="module")
def evaluators(tmp_path_factory, small, lpips_weights) -> dict[str, Evaluator]:
    """Of the same shape in one colour, and with stripes."""
    variant.use("cpu")
    vertices, faces = ball()
    made = {}
    for name, albedo in (("plain", lambda p, n: np.full((len(p), 3), np.float32(0.4))), ("striped", striped)):
        folder, xml, options = tmp_path_factory.mktemp(name), scene_file.find("default"), RenderSettings(0.95, 96)
        normals = bridge.write_ply(folder / "part.ply", vertices, faces)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(target, "FINEST", 4 * len(faces))
            reference = target.build_reference(xml, folder, vertices, faces, normals, albedo, options)
        part = scene.load(xml, folder / "part.ply", **asdict(options))
        made[name] = replace(evaluator.build_evaluator(reference, part, ("alex", "vgg")), views=VIEWS)
    return made


def moved(amount: float = 0.0) -> torch.Tensor:
    vertices, _ = ball()
    bumps = 1 + amount * np.sin(25 * vertices[:, :1]) * np.sin(25 * vertices[:, 1:2])
    return torch.tensor(vertices * bumps, dtype=torch.float32)


class TestEvaluator:
    def test_the_same_shape_in_one_colour_is_perfect(self, evaluators):
        score = evaluators["plain"].score(evaluators["plain"].aligned(moved()))
        assert set(score) == KEYS
        for name, value in score.items():
            assert value == pytest.approx(1 if "ssim" in name else 0, abs=2e-4), name

    def test_relief_where_there_is_no_detail_costs(self, evaluators):
        scorer = evaluators["plain"]
        scores = [scorer.score(scorer.aligned(moved(amount))) for amount in (0.0, 0.002, 0.006)]
        for name in KEYS:
            values = [score[name] for score in scores]
            assert values == sorted(values, reverse="ssim" in name), name
            assert abs(values[2] - values[0]) > 2e-3, name

    def test_detail_that_is_missing_costs(self, evaluators):
        score = evaluators["striped"].score(evaluators["striped"].aligned(moved()))
        assert score["ssim"] < 0.95 and score["lpips_alex"] > 0.02 and score["g_ssim"] < 0.95
        # The background is equal in both: what is lost is lost inside
        assert score["ssim_mask"] < score["ssim"] and score["lpips_mask_alex"] > score["lpips_alex"]

    def test_exposure_and_paint_cost_nothing(self, evaluators):
        """A part of another grey looks the same after alignment, whose exposure is that of the part in its paint."""
        scorer = evaluators["striped"]
        before = scorer.aligned(moved())
        key = f"{scorer.scene.shape_id}.bsdf.albedo.value"
        paint = float(np.ravel(scorer.scene.params[key])[0])
        scorer.scene.params[key] = paint / 2
        scorer.scene.params.update()
        try:
            again = replace(evaluator.build_evaluator(scorer.reference, scorer.scene, ()), views=VIEWS)
            assert again.alignment.exposure == pytest.approx(2 * scorer.alignment.exposure, rel=1e-2)
            assert (again.aligned(moved()) - before).abs().max() < 5e-3
        finally:
            scorer.scene.params[key] = paint
            scorer.scene.params.update()

    def test_image_as_it_is_compared(self, evaluators):
        scorer = evaluators["striped"]
        image = scorer.aligned(moved(0.006))
        assert image.shape == scorer.target.shape == (2, 1, 96, 96)
        for x in (image, scorer.target):
            assert x.min() >= 0 and 0.5 < x.max() <= 1
            assert (x[scorer.mask == 0] == 0).all()
        in_the_paper = scorer.align(scorer.render(moved(0.006)), Alignment("paper"))
        for ours, theirs, mask in zip(in_the_paper, scorer.target, scorer.mask, strict=True):
            weights = mask.numpy().ravel()
            assert np.average(ours.numpy().ravel(), weights=weights) == pytest.approx(
                np.average(theirs.numpy().ravel(), weights=weights), abs=0.03
            )  # clipped values are all that differs

    def test_the_same_twice(self, evaluators):
        scorer = evaluators["striped"]
        first, second = (scorer.score(scorer.aligned(moved(0.003)), networks=("alex",)) for _ in range(2))
        assert first["lpips_vgg"] is first["lpips_mask_vgg"] is None
        assert {k: v for k, v in first.items() if v is not None} == pytest.approx(
            {k: v for k, v in second.items() if v is not None}, abs=1e-5
        )

    def test_no_derivatives_are_kept(self, evaluators):
        vertices = moved().requires_grad_()
        assert not evaluators["plain"].aligned(vertices).requires_grad


def test_ssim_is_that_of_scikit_image():
    rng = np.random.default_rng(0)
    a, b = rng.random((2, 3, 1, 40, 40)).astype(np.float32)
    mask = np.zeros_like(a)
    mask[..., 10:20, 5:30] = 1
    frame, inside = ssim(*map(torch.tensor, (a, b, mask)))
    expected = [structural_similarity(x[0], y[0], data_range=1.0, full=True) for x, y in zip(a, b, strict=True)]
    assert frame == pytest.approx(np.mean([mean for mean, _ in expected]))
    assert inside == pytest.approx(np.mean([local[10:20, 5:30].mean() for _, local in expected]))


class TestUnseen:
    @pytest.mark.parametrize("name", SETS)
    def test_between_the_standard_views(self, name):
        views = SETS[name]
        between = unseen_views(views)
        assert len(between) == len(set(between)) == len(views)
        around = sorted(view.azimuth % 360 for view in views)
        for i, view in enumerate(sorted(between, key=lambda v: (v.azimuth - around[0]) % 360)):
            low, high = around[i], around[(i + 1) % len(around)] + 360 * (i + 1 == len(around))
            assert view.azimuth % 360 == pytest.approx((low + high) / 2 % 360)
            assert abs(view.elevation) < 60

    @pytest.mark.parametrize("name", SETS)
    def test_none_was_seen(self, name):
        """Each is 10° or more from every standard view, or lit from elsewhere."""
        for view in unseen_views(SETS[name]):
            assert view.light_turn in UNSEEN_TURNS
            for seen in SETS[name]:
                away = abs((view.azimuth - seen.azimuth + 180) % 360 - 180)
                assert max(away, abs(view.elevation - seen.elevation)) >= 10

    def test_each_lighting_half_of_the_time(self):
        turns = [view.light_turn for view in unseen_views(SETS["default"])]
        assert [turns.count(turn) for turn in UNSEEN_TURNS] == [3, 3]

    def test_one_view(self):
        assert unseen_views((View(20, 0),)) == (View(200, 5.0, UNSEEN_TURNS[0]),)


@pytest.mark.usefixtures("small", "lpips_weights")
class TestEvaluate:
    @pytest.fixture(autouse=True)
    def _coarse(self, monkeypatch):
        """The default mesh and reference are far finer than such small pictures show."""
        monkeypatch.setattr(target, "FINEST", 40_000)
        settings = RefineConfig(max_faces=10_000, edge_mm=2.0)
        monkeypatch.setattr(evaluation, "RefineConfig", lambda **given: replace(settings, **given))

    def test_a_pair_of_files(self, tmp_path, two_views):
        """The painted shape against bumpy ones, as a GLB and as a print file, lying and in facets."""
        vertices, faces = ball(4)
        original = trimesh.Trimesh(vertices, faces, process=False)
        original.visual.vertex_colors = np.uint8(255 * np.column_stack([striped(vertices), np.ones(len(vertices))]))
        original.export(tmp_path / "striped.ply")
        bumpy = vertices * (1 + 0.01 * np.sin(12 * vertices[:, 1:2] + 3 * vertices[:, :1]))
        upright = trimesh.Trimesh(bumpy, faces, process=False)
        upright.export(tmp_path / "bumpy.glb")
        lying = trimesh.Trimesh(40 * bumpy[:, [0, 2, 1]] * [1, -1, 1] + [100, 50, 7], faces, process=False)
        lying.export(tmp_path / "bumpy.stl")
        results = [
            genmf_mi.evaluate(str(tmp_path / "striped.ply"), tmp_path / name, scene=two_views, networks=("alex",))
            for name in ("bumpy.glb", "bumpy.stl")
        ]
        for metrics in results:
            assert set(metrics) == {"asset", "before", "after", "unseen", "paper_alignment"}
            assert set(metrics["unseen"]) == {"before", "after", "paper_alignment"}
            assert metrics["asset"] == "striped"
            for block in (metrics, metrics["unseen"]):
                assert set(block["before"]) == set(block["after"]) == KEYS | {"outline_iou"}
                assert set(block["paper_alignment"]["after"]) == KEYS
                assert block["before"]["outline_iou"] > 0.999 > block["after"]["outline_iou"]
                assert block["after"]["g_ssim"] > block["before"]["g_ssim"]
        for name in ("ssim", "lpips_alex", "g_ssim"):
            values = [metrics["after"][name] for metrics in results]
            assert np.ptp(values) < 2e-3, name

    def test_the_shape_itself_scores_as_before(self, two_views):
        vertices, faces = ball(4)
        original = Asset.from_arrays("striped", vertices, faces, colours=striped(vertices))
        same = Asset.from_arrays("same", vertices, faces)
        metrics = genmf_mi.evaluate(original, same, scene=two_views, networks=("alex",))
        for block in (metrics, metrics["unseen"]):
            assert block["after"]["ssim"] == pytest.approx(block["before"]["ssim"], abs=5e-3)
            assert block["after"]["lpips_alex"] == pytest.approx(block["before"]["lpips_alex"], abs=5e-3)

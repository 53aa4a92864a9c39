"""Every example at a small size, with the numbers that it gave when it was written."""

from __future__ import annotations

import importlib.util
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import pytest
import trimesh
from toys import painted

import genmf_mi

EXAMPLES = Path(__file__).parents[2] / "examples"
SMALL = genmf_mi.RefineConfig(
    max_relief_mm=2.0, iterations=6, resolution=96, score_vgg=False, stress=False, learning_rate=0.0125, device="cpu"
)


def load(name: str) -> ModuleType:
    """The example as a module, without running it."""
    spec = importlib.util.spec_from_file_location(f"example_{name}", EXAMPLES / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_example_is_tested():
    assert {path.stem for path in EXAMPLES.glob("*.py")} == {
        "custom_loss",
        "refine_field",
        "refine_mesh",
        "stress_only",
    }


def test_stress_only(tmp_path):
    """Of the bracket that it takes without a file, from a file."""
    example, path = load("stress_only"), tmp_path / "bracket.ply"
    trimesh.Trimesh(*example.bracket()).export(path)
    stress = example.main(path, edge_mm=4.0)
    assert stress["simulated"] == pytest.approx({"mean": 0.640, "p99_9": 2.067, "max": 2.674}, rel=0.01)
    # The network may compute in bfloat16
    assert stress["predicted"] == pytest.approx({"mean": 0.632, "p99_9": 1.883, "max": 2.258}, rel=0.03)


@pytest.mark.usefixtures("small_refinements")
class TestRefinements:
    """SSIM does not depend on the LPIPS weights that happen to be installed, other than after the optimisation."""

    def test_refine_mesh(self, tmp_path, two_views, capsys):
        asset, out = painted(tmp_path / "egg.ply"), tmp_path / "out"
        result = load("refine_mesh").main(asset, out, config=SMALL, scene=two_views)
        printed = capsys.readouterr().out
        assert {"refined.3mf", "before_after.png", "report.html"} <= {path.name for path in out.iterdir()}
        ssim = {name: result.metrics[name]["ssim"] for name in ("before", "displacement", "after")}
        assert ssim == pytest.approx({"before": 0.507, "displacement": 0.479, "after": 0.486}, abs=0.03)
        assert 0.7 < result.metrics["relief_mm"]["max"] <= 2.0
        assert "refining ..." in printed and "SSIM 0.4" in printed

    def test_refine_field(self, two_views, capsys):
        result = load("refine_field").main(out=None, samples=33, config=SMALL, scene=two_views)
        ssim = {name: result.metrics[name]["ssim"] for name in ("before", "after")}
        assert ssim == pytest.approx({"before": 0.700, "after": 0.708}, abs=0.02)
        assert result.metrics["solid"]["volume_mm3"] == pytest.approx(206_100, rel=0.01)
        assert "closed: True, bodies: 1" in capsys.readouterr().out

    def test_custom_loss(self, tmp_path, two_views, capsys):
        """0.514 mm in the foot and 0.570 mm above it without the term, 0.300 and 0.423 mm with it."""
        asset, main = painted(tmp_path / "egg.ply"), load("custom_loss").main
        config = replace(SMALL, iterations=20)
        foot, above = main(asset, weight=0.0, config=config, scene=two_views)
        flat_foot, above_it = main(asset, weight=100.0, config=config, scene=two_views)
        assert (foot, above) == pytest.approx((0.514, 0.570), rel=0.1)
        assert (flat_foot, above_it) == pytest.approx((0.300, 0.423), rel=0.15)
        printed = capsys.readouterr().out
        assert "the term is 0.0000" in printed
        assert float(printed.rpartition("the term is ")[2].split()[0]) > 0.1

"""``genmf-mi refine``: what reaches the settings, and what a person reads at the end."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
from toys import painted

from genmf_mi.cli import main as cli
from genmf_mi.cli.progress import TerminalProgress
from genmf_mi.core.config import PRESETS, RefineConfig
from genmf_mi.pipeline import displacement, evaluator, refinement
from genmf_mi.pipeline.run_folder import CHECKPOINT
from genmf_mi.render import target

pytestmark = pytest.mark.usefixtures("workplace")

ROW = {"ssim": 0.91234, "lpips_alex": 0.1, "lpips_vgg": None, "g_ssim": 0.8, "g_lpips": 0.2}
METRICS = {
    "asset": "toy",
    "before": ROW,
    "after": ROW,
    "relief_mm": {"max": 0.9, "mean": 0.2},
    "solid": {"watertight": True, "bodies": 1, "self_intersections": 0},
    "seconds": {"total": 1.0},
    "interrupted": False,
}


class TestSettings:
    @pytest.fixture
    def chosen(self, monkeypatch):
        """What the command calls the refinement with."""
        calls = []

        def fake(asset, config, *, progress, **options) -> SimpleNamespace:
            calls.append((asset, config, options))
            return SimpleNamespace(metrics=METRICS, out=None)

        monkeypatch.setattr(refinement, "refine", fake)

        def of(*arguments: str) -> tuple[str, RefineConfig, dict]:
            assert cli.main(["refine", *arguments]) == 0
            return calls[-1]

        return of

    def test_defaults(self, chosen):
        asset, config, options = chosen("bus.glb")
        assert (asset, config) == ("bus.glb", RefineConfig())
        assert options == {"out": Path("runs/bus"), "textured": None, "up": None,
                           "files_anywhere": False, "scene": None, "references": (),
                           "verify": False, "print_check": False, "force": False, "resume": False,
                           "save_exr": False}  # fmt: skip

    @pytest.mark.parametrize("preset", PRESETS)
    @pytest.mark.parametrize("form", ["--preset {}", "--preset={}"])
    def test_preset(self, chosen, preset, form):
        assert chosen("bus.glb", *form.format(preset).split())[1] == PRESETS[preset]
        assert chosen(*form.format(preset).split(), "bus.glb")[1] == PRESETS[preset]

    @pytest.mark.parametrize("before", [True, False])
    def test_overrides_on_top_of_a_preset(self, chosen, before):
        overrides = ["--size-mm", "80", "--iterations", "7", "--view-jitter", "10", "5", "--method", "displacement",
                     "--silhouettes", "--device", "cpu"]  # fmt: skip
        preset = ["--preset", "draft"]
        _, config, _ = chosen("bus.glb", *(overrides + preset if before else preset + overrides))
        assert config == replace(PRESETS["draft"], size_mm=80.0, iterations=7, view_jitter=(10.0, 5.0),
                                 method="displacement", silhouettes=True, device="cpu")  # fmt: skip

    @pytest.mark.parametrize("preset", PRESETS)
    @pytest.mark.parametrize("name", ["score_vgg", "silhouettes", "stress"])
    def test_switches_of_any_preset_both_ways(self, chosen, preset, name):
        flag = name.replace("_", "-")
        for word, value in ((f"--{flag}", True), (f"--no-{flag}", False)):
            _, config, _ = chosen("bus.glb", "--preset", preset, word)
            assert config == replace(PRESETS[preset], **{name: value})

    def test_weights(self, chosen):
        _, config, _ = chosen("bus.glb", "--preset", "paper", "--grey-l1", "0.25", "--gradient-sign", "0")
        assert config.weights == replace(PRESETS["paper"].weights, grey_l1=0.25, gradient_sign=0.0)

    def test_everything_else(self, chosen):
        _, _, options = chosen("bus.npz", "--textured", "bus.glb", "--out", "here", "--scene", "my.xml", "--reference",
                               "a.png@0,10",
                               "--reference", "b.png@-90,5", "--verify", "--print-check", "--slicer", "own",
                               "--force", "--save-exr", "--files-anywhere",
                               "--quiet")  # fmt: skip
        assert options == {"out": Path("here"), "scene": Path("my.xml"), "force": True, "resume": False,
                           "textured": Path("bus.glb"), "up": None, "files_anywhere": True,
                           "references": ("a.png@0,10", "b.png@-90,5"), "verify": True, "print_check": "own",
                           "save_exr": True}  # fmt: skip
        assert chosen("bus.glb", "--resume")[2]["resume"]

    @pytest.mark.parametrize(
        "arguments",
        [["bus.glb", "--size-mm", "large"], ["bus.glb", "--no-such-thing"], ["bus.glb", "--preset", "fast"], [],
         ["bus.glb", "--method", "magic"], ["bus.glb", "--view-jitter", "3"]],
    )  # fmt: skip
    def test_what_cannot_be_understood(self, arguments, capsys):
        with pytest.raises(SystemExit) as caught:
            cli.main(["refine", *arguments])
        assert caught.value.code == 2
        captured = capsys.readouterr()
        assert captured.err and "Traceback" not in captured.err + captured.out


SMALL = ["--iterations", "3", "--resolution", "96", "--max-faces", "3000", "--edge-mm", "4", "--device", "cpu",
         "--no-score-vgg", "--no-stress"]  # fmt: skip


@pytest.mark.usefixtures("lpips_weights")
class TestWholeRun:
    @pytest.fixture(autouse=True)
    def _small(self, monkeypatch):
        monkeypatch.setattr(evaluator, "RESOLUTION", 64)
        monkeypatch.setattr(evaluator, "SAMPLES", 4)
        monkeypatch.setattr(target, "FINEST", 12_000)
        monkeypatch.setattr(displacement, "AMPLITUDES", (0.5,))

    def test_ctrl_c(self, capsys, monkeypatch, two_views):
        """Reported, with what to do next; not a failure, since the part so far is written."""

        def stop(*_):
            raise KeyboardInterrupt

        monkeypatch.setattr(TerminalProgress, "advance", stop)
        assert cli.main(["refine", painted("toy.ply"), *SMALL, "--scene", str(two_views), "--out", "here"]) == 0
        captured = capsys.readouterr()
        assert "interrupted after 1 iterations" in captured.out and "--resume" in captured.out
        assert Path("here/refined.3mf").exists() and Path("here", CHECKPOINT).exists()


def test_stress_is_printed_where_it_was_verified(monkeypatch, capsys):
    """A second table, with the ratios; the scores of the shape without the stress stage among the others."""
    stress = {"von_mises_mpa": {"p99_9": 2.0, "mean": 0.4}, "surface_band": {"mean": 0.5, "p99_9": 1.5}}
    ratios = dict.fromkeys(("p99_9", "mean", "surface_band_mean", "surface_band_p99_9"), 1.25)
    shapes = {"shapes": {"before": stress, "after": stress}, "ratio": {"after": ratios}}
    metrics = {**METRICS, "unconstrained": ROW, "stress": shapes}
    monkeypatch.setattr(refinement, "refine", lambda *_, **options: SimpleNamespace(metrics=metrics, out=None))
    assert cli.main(["refine", "toy.ply", "--quiet", "--verify"]) == 0
    text = capsys.readouterr().out
    assert "finite elements" in text and text.count("×1.25") == 4 and "unconstrained" in text
    assert "watertight, 1 component, 0 self-intersections" in text


@pytest.mark.parametrize("quiet", [True, False])
def test_warnings_are_printed(monkeypatch, capsys, quiet):
    def fake(*_, progress, **__) -> SimpleNamespace:
        progress.stage("loading")
        progress.warn("the walls are thin")
        return SimpleNamespace(metrics=METRICS, out=None)

    monkeypatch.setattr(refinement, "refine", fake)
    assert cli.main(["refine", "toy.ply", *(["--quiet"] if quiet else [])]) == 0
    assert capsys.readouterr().err == "warning: the walls are thin\n"

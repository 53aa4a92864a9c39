"""The command line: what reaches the settings, and what a person reads when something is wrong."""

from __future__ import annotations

import json
import os
import re
import resource
import struct
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

import genmf_mi
from genmf_mi import cli, displacement, evaluate, fabricate, prepare, progress, scene, target, variant, weights
from genmf_mi.config import PRESETS, RefineConfig
from genmf_mi.losses import perceptual

HEAVY = {"mitsuba", "drjit", "torch", "pymeshlab", "matplotlib", "igl"}
COMMANDS = ("refine", "evaluate", "batch", "scene", "samples", "stress", "weights", "doctor")


@pytest.fixture(autouse=True)
def _here(tmp_path, monkeypatch):
    """A working folder and a folder for temporary files of its own."""
    (tmp_path / "work").mkdir()
    (tmp_path / "scratch").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "scratch"))


def ball() -> trimesh.Trimesh:
    mesh = trimesh.creation.icosphere(3)
    return trimesh.Trimesh(mesh.vertices * (1, 0.8, 0.9), mesh.faces, process=False)


def painted(path: Path) -> Path:
    mesh = ball()
    bright = np.sin(9 * mesh.vertices[:, 1]) > 0
    mesh.visual.vertex_colors = np.where(bright[:, None], (220, 120, 120, 255), (60, 60, 60, 255)).astype(np.uint8)
    mesh.export(path)
    return path


class TestHelp:
    def test_all_commands_are_listed(self, capsys):
        assert cli.main(["--help"]) == 0
        text = capsys.readouterr().out
        assert all(f"genmf-mi {command}" in text for command in COMMANDS)

    def test_without_a_command(self, capsys):
        assert cli.main([]) == 2
        assert "genmf-mi refine" in capsys.readouterr().out

    def test_unknown_command(self, capsys):
        assert cli.main(["refien", "a.glb"]) == 2
        captured = capsys.readouterr()
        assert "no command 'refien'" in captured.err.splitlines()[0] and "genmf-mi refine" in captured.err

    def test_version(self, capsys):
        assert cli.main(["--version"]) == 0
        assert capsys.readouterr().out.strip() == genmf_mi.__version__

    @pytest.mark.parametrize("command", COMMANDS)
    def test_of_each_command(self, command, capsys):
        with pytest.raises(SystemExit) as caught:
            cli.main([command, "--help"])
        assert caught.value.code == 0
        assert f"genmf-mi {command}" in capsys.readouterr().out

    def test_starts_nothing_heavy(self):
        """One process asks every command."""
        code = f"""
import contextlib, io, sys
from genmf_mi import cli
for command in {COMMANDS}:
    with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):
        cli.main([command, "--help"])
    print(command, *sorted({HEAVY} & set(sys.modules)))
"""
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, encoding="utf-8", check=True)
        assert done.stdout.split("\n")[:-1] == list(COMMANDS)

    def test_every_setting_is_explained(self, capsys):
        with pytest.raises(SystemExit):
            cli.main(["refine", "--help"])
        text = re.sub(r"[\s│|]+", " ", capsys.readouterr().out)
        for name in RefineConfig.__dataclass_fields__:
            if name != "weights":
                assert f"--{name.replace('_', '-')}" in text
        assert "Longest side of the printed part" in text and "L_geo" in text


class TestSettings:
    @pytest.fixture
    def chosen(self, monkeypatch):
        """What the command would run with."""
        calls = []
        monkeypatch.setattr(progress, "run_refine", lambda asset, config, **options: calls.append((asset, config, options)))

        def of(*arguments: str) -> tuple[str, RefineConfig, dict]:
            assert cli.main(["refine", *arguments]) == 0
            return calls[-1]

        return of

    def test_defaults(self, chosen):
        asset, config, options = chosen("bus.glb")
        assert (asset, config) == ("bus.glb", RefineConfig())
        assert options == {"out": None, "quiet": False, "scene": None, "references": (), "force": False, "resume": False,
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

    def test_weights(self, chosen):
        _, config, _ = chosen("bus.glb", "--preset", "paper", "--grey-l1", "0.25", "--polarity", "0")
        assert config.weights == replace(PRESETS["paper"].weights, grey_l1=0.25, polarity=0.0)

    def test_everything_else(self, chosen):
        _, _, options = chosen("bus.glb", "--out", "here", "--scene", "my.xml", "--reference", "a.png@0,10", "--reference",
                               "b.png@-90,5", "--force", "--save-exr", "--quiet")  # fmt: skip
        assert options == {"out": Path("here"), "quiet": True, "scene": Path("my.xml"), "force": True, "resume": False,
                           "references": ("a.png@0,10", "b.png@-90,5"), "save_exr": True}  # fmt: skip
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


def glb(tree: dict, binary: bytes = b"") -> bytes:
    text = json.dumps({"asset": {"version": "2.0"}, **tree}).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    if binary:
        chunks += struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def textured_square() -> trimesh.Trimesh:
    """Two triangles with a checkerboard: a sheet."""
    picture = Image.fromarray((np.indices((8, 8)).sum(0) % 2 * 255).astype(np.uint8))
    mesh = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]], process=False)
    uv = mesh.vertices[:, :2]
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=picture)
    mesh.visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    return mesh


def asset_without_texture_file() -> str:
    Path("toy.mtl").write_text("newmtl paint\nmap_Kd paint.png\n")
    lines = ["mtllib toy.mtl", "usemtl paint", *(f"v {x} {y} {z}" for x, y, z in ball().vertices), "vt 0 0"]
    Path("toy.obj").write_text("\n".join([*lines, *(f"f {a}/1 {b}/1 {c}/1" for a, b, c in ball().faces + 1)]))
    return "toy.obj"


def asset_with_nan() -> str:
    mesh = ball()
    mesh.vertices[10, 1] = np.nan
    mesh.visual.vertex_colors = np.random.default_rng(0).integers(0, 255, (len(mesh.vertices), 4))
    mesh.export("nan.ply")
    return "nan.ply"


def asset_from(name: str, content: bytes | str) -> str:
    Path(name).write_bytes(content if isinstance(content, bytes) else content.encode())
    return name


def truncated() -> str:
    data = painted(Path("whole.glb")).read_bytes()
    Path("whole.glb").unlink()
    return asset_from("cut.glb", data[: len(data) // 2])


def scene_file(old: str, new: str) -> list[str]:
    text = scene.find("default").read_text()
    assert old in text
    return ["--scene", asset_from("my.xml", text.replace(old, new))]


def toy() -> str:
    return str(painted(Path("toy.ply")))


MATERIAL = re.search(r"<bsdf.*</bsdf>", scene.find("default").read_text(), re.DOTALL).group()

# What is wrong: the arguments, and what the message must name
BAD = {
    "missing file": (lambda: ["nowhere.glb"], "nowhere.glb"),
    "missing folder": (lambda: ["no/where.obj"], "no/where.obj"),
    "a folder": (lambda: ["."], "."),
    "empty file": (lambda: [asset_from("empty.glb", b"")], "empty.glb is empty"),
    "truncated GLB": (lambda: [truncated()], "cut.glb"),
    "not a GLB": (lambda: [asset_from("text.glb", "solid nonsense" * 9)], "text.glb"),
    "GLB without a mesh": (lambda: [asset_from("none.glb", glb({"scenes": [{"nodes": [0]}], "nodes": [{}]}))], "no triangles"),
    "NaN vertices": (lambda: [asset_with_nan()], "not numbers"),
    "plane": (lambda: [asset_from("plane.glb", textured_square().export(file_type="glb"))], "without thickness"),
    "texture missing": (lambda: [asset_without_texture_file()], "paint.png"),
    "unknown format": (lambda: [asset_from("toy.fbx", b"Kaydara FBX")], ".fbx"),
    "no suffix": (lambda: [asset_from("toy", b"x")], "unknown kind"),
    "no texture": (lambda: [asset_from("plain.glb", ball().export(file_type="glb"))], "--reference"),
    "reference without angles": (lambda: [toy(), "--reference", "front.png"], "azimuth,elevation"),
    "reference missing": (lambda: [toy(), "--reference", "front.png@0,0"], "front.png"),
    "no such scene": (lambda: [toy(), "--scene", "my.xml"], "my.xml"),
    "unreadable XML": (lambda: [toy(), *scene_file("</scene>", "")], "my.xml"),
    "XML with an unknown plugin": (lambda: [toy(), *scene_file('"multijitter"', '"magic"')], "magic"),
    "XML without twolight": (lambda: [toy(), *scene_file(MATERIAL, '<bsdf type="diffuse"/>')], "twolight"),
    "XML without views": (lambda: [toy(), *scene_file('name="views"', 'name="sights"')], "views"),
    "size zero": (lambda: [toy(), "--size-mm", "0"], "size-mm"),
    "size negative": (lambda: [toy(), "--size-mm", "-5"], "size-mm"),
    "size not a number": (lambda: [toy(), "--size-mm", "nan"], "size-mm"),
    "cap negative": (lambda: [toy(), "--max-relief-mm", "-0.1"], "max-relief-mm"),
    "cap too large": (lambda: [toy(), "--max-relief-mm", "30"], "max-relief-mm"),
    "weight negative": (lambda: [toy(), "--polarity", "-1"], "polarity"),
    "too few faces": (lambda: [toy(), "--max-faces", "12"], "max-faces"),
    "output is a file": (lambda: [toy(), "--out", asset_from("results", b"mine")], "results"),
    "output below a file": (lambda: [toy(), "--out", asset_from("results", b"mine") + "/toy"], "results/toy"),
    "output below /proc": (lambda: [toy(), "--out", "/proc/toy"], "/proc/toy"),
    "nothing to resume": (lambda: [toy(), "--resume"], "no interrupted run"),
}  # fmt: skip


def said(capsys) -> str:
    """The error that was printed: one line, alone on standard error."""
    captured = capsys.readouterr()
    assert "Traceback" not in captured.out + captured.err
    (line,) = captured.err.strip().splitlines()
    assert line.startswith("error: ") and line.endswith(".")
    assert 20 < len(line) < 400
    return line


def files_here() -> set[str]:
    """All files in the working folder and the folder for temporary files."""
    return {str(path) for folder in (Path("."), Path(tempfile.gettempdir())) for path in folder.rglob("*") if path.is_file()}


class TestBadInput:
    @pytest.mark.parametrize("quiet", [True, False])
    @pytest.mark.parametrize("name", BAD)
    def test_is_one_line_and_exit_code_2(self, name, quiet, capsys):
        make, message = BAD[name]
        arguments, before = make(), files_here()
        assert cli.main(["refine", *arguments, *(["--quiet"] if quiet else [])]) == 2
        assert message in said(capsys)
        left = files_here() - before - {f"runs/{Path(arguments[0]).stem}/config.yaml"}
        assert left == set()

    def test_can_be_mended_and_tried_again(self, capsys, monkeypatch):
        """The failed attempt must not stand in the way of the next."""
        assert cli.main(["refine", toy(), "--scene", "my.xml"]) == 2
        monkeypatch.setattr(prepare, "prepare", lambda *_, **__: (_ for _ in ()).throw(KeyboardInterrupt))
        assert cli.main(["refine", "toy.ply"]) == cli.INTERRUPTED
        assert capsys.readouterr().err.splitlines()[-1] == "interrupted"

    def test_llvm_too_old(self, capsys, monkeypatch):
        for found, message in (((15, 0, 7), "LLVM 15.0.7"), (None, "no LLVM library")):
            monkeypatch.setattr(variant, "llvm_version", lambda found=found: found)
            assert cli.main(["refine", toy(), "--device", "cpu"]) == 2
            line = said(capsys)
            assert message in line and "apt-get install" in line
        assert not Path("runs").exists()

    def test_no_lpips_weights(self, capsys, monkeypatch, tmp_path):
        """Before any work is done."""
        monkeypatch.setenv("GENMF_LPIPS_WEIGHTS", str(tmp_path / "no weights"))
        monkeypatch.setattr(weights, "missing", lambda: [n for n in weights.NETWORKS if not weights._file(n).is_file()])
        monkeypatch.setattr(prepare, "prepare", lambda *_, **__: pytest.fail("this should have been refused before"))
        assert cli.main(["refine", toy()]) == 2
        assert "genmf-mi weights" in said(capsys)
        perceptual._network.cache_clear()

    def test_no_gpu(self, capsys):
        if variant.cuda_available():
            pytest.skip("there is one")
        assert cli.main(["refine", toy(), "--device", "cuda"]) == 2
        assert "--device cpu" in said(capsys)

    @pytest.mark.parametrize("arguments", [["toy.ply", "nowhere.stl"], ["nowhere.glb", "toy.ply"], ["plain.glb", "toy.ply"]])
    def test_evaluate(self, arguments, capsys):
        toy()
        asset_from("plain.glb", ball().export(file_type="glb"))
        assert cli.main(["evaluate", *arguments]) == 2
        assert re.search(r"nowhere|no texture", said(capsys))

    def test_scene(self, capsys):
        assert cli.main(["scene", "nowhere.glb"]) == 2
        assert "nowhere.glb" in said(capsys)


SMALL = ["--iterations", "3", "--resolution", "96", "--max-faces", "3000", "--edge-mm", "4", "--device", "cpu",
         "--no-score-vgg"]  # fmt: skip


@pytest.mark.usefixtures("lpips_weights")
class TestWholeRun:
    @pytest.fixture(autouse=True)
    def _small(self, monkeypatch):
        monkeypatch.setattr(evaluate, "RESOLUTION", 64)
        monkeypatch.setattr(evaluate, "SAMPLES", 4)
        monkeypatch.setattr(target, "FINEST", 12_000)
        monkeypatch.setattr(displacement, "AMPLITUDES", (0.5,))

    @pytest.mark.parametrize("name", ["refined.3mf", "refined.stl", "refined.glb"])
    def test_disk_full_while_writing(self, name, capsys, monkeypatch, two_views):
        """A limit on the size of files while this one is written. Nothing is lost: the run can be finished."""
        writer = getattr(fabricate, f"_write_{name[-3:]}")

        def full(*arguments):
            before = resource.getrlimit(resource.RLIMIT_FSIZE)
            resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
            try:
                return writer(*arguments)
            finally:
                resource.setrlimit(resource.RLIMIT_FSIZE, before)

        arguments = ["refine", toy(), *SMALL, "--scene", str(two_views), "--quiet"]
        with monkeypatch.context() as patch:
            patch.setattr(fabricate, f"_write_{name[-3:]}", full)
            assert cli.main(arguments) == 2
        assert name in said(capsys)
        left = set(os.listdir("runs/toy"))
        assert {"checkpoint.npz", "metrics.jsonl", "config.yaml"} <= left
        assert left <= {"checkpoint.npz", "metrics.jsonl", "config.yaml", "refined.3mf", "refined.stl"} - {name}
        assert os.listdir(tempfile.gettempdir()) == []

        assert cli.main([*arguments, "--resume"]) == 0
        assert set(os.listdir("runs/toy")) == {
            "metrics.jsonl", "config.yaml", "metrics.json", "refined.3mf", "refined.stl", "refined.glb", "report.html",
            "before_after.png"}  # fmt: skip
        captured = capsys.readouterr()
        assert captured.err == ""
        assert "watertight" in captured.out and "runs/toy/refined.3mf" in captured.out
        assert re.search(r"before .*\n.*displacement .*\n.*after ", captured.out)

    def test_ctrl_c(self, capsys, monkeypatch, two_views):
        """Said, with what to do next; not a failure, since the part so far is there."""

        def stop(self, index, count, terms):
            raise KeyboardInterrupt

        monkeypatch.setattr(progress.Terminal, "iteration", stop)
        assert cli.main(["refine", toy(), *SMALL, "--scene", str(two_views), "--out", "here"]) == 0
        captured = capsys.readouterr()
        assert "interrupted after 1 iterations" in captured.out and "--resume" in captured.out
        assert Path("here/refined.3mf").exists() and Path("here/checkpoint.npz").exists()


class TestEvaluateOutput:
    row = {"ssim": 0.91234, "lpips_alex": 0.1, "lpips_vgg": None, "g_ssim": 0.8, "g_lpips": 0.2}
    metrics = {"asset": "toy", "before": row, "after": row, "unseen": {"before": row, "after": row}}

    @pytest.fixture(autouse=True)
    def _stub(self, monkeypatch):
        calls = []
        monkeypatch.setattr(evaluate, "evaluate", lambda *a, **k: calls.append((a, k)) or self.metrics)
        self.calls = calls

    def test_table(self, capsys):
        assert cli.main(["evaluate", "a.glb", "b.stl", "--size-mm", "80"]) == 0
        text = capsys.readouterr().out
        assert text.count("0.9123") == 4 and text.count("–") >= 4 and "unseen: after" in text
        (paths, options), = self.calls  # fmt: skip
        assert [str(path) for path in paths] == ["a.glb", "b.stl"] and options["size_mm"] == 80

    def test_json(self, capsys):
        assert cli.main(["evaluate", "a.glb", "b.stl", "--json"]) == 0
        assert json.loads(capsys.readouterr().out) == self.metrics


def test_scene_command_prints_a_scene(capsys):
    assert cli.main(["scene", toy()]) == 0
    Path("my.xml").write_text(capsys.readouterr().out)
    assert scene.read_defaults(Path("my.xml"))["mesh"] == "toy.ply"


def test_installed_command():
    """`python -m genmf_mi` is the same command."""
    done = subprocess.run([sys.executable, "-m", "genmf_mi", "refine", "nowhere.glb"], capture_output=True, encoding="utf-8")
    assert done.returncode == 2
    assert done.stderr.startswith("error: ") and len(done.stderr.splitlines()) == 1

"""What is wrong with the input or the machine ends in exit code 2 and one line that says what, and what to do."""

from __future__ import annotations

import os
import re
import tempfile
from pathlib import Path

import numpy as np
import pytest
from gltf_writer import Gltf, textured_quad
from PIL import Image
from toys import egg, painted

from genmf_mi.cli import main as cli
from genmf_mi.fabrication import files as fabrication
from genmf_mi.losses import lpips_conversion, perceptual
from genmf_mi.losses import lpips_weights as weights
from genmf_mi.mesh import solid
from genmf_mi.pipeline import displacement, evaluation, evaluator, problem, refinement
from genmf_mi.pipeline.run_folder import CHECKPOINT
from genmf_mi.render import scene, target, variant

pytestmark = pytest.mark.usefixtures("workplace", "lpips_weights")

DEFAULT = scene.standalone_xml("default", "mesh.ply")
BSDF = re.search(r"<bsdf.*</bsdf>", DEFAULT, re.DOTALL).group()


def file(name: str, content: bytes = b"") -> str:
    Path(name).write_bytes(content)
    return name


def truncated(name: str) -> str:
    data = Path(painted(f"whole{Path(name).suffix}")).read_bytes()
    return file(name, data[: len(data) // 2])


def plain(name: str) -> str:
    egg().export(name)
    return name


def not_a_number() -> str:
    mesh = egg()
    mesh.vertices[10, 1] = np.nan
    mesh.visual.vertex_colors = np.random.default_rng(0).integers(0, 255, (len(mesh.vertices), 4))
    mesh.export("nan.ply")
    return "nan.ply"


def plane() -> str:
    checks = np.repeat((np.indices((8, 8)).sum(0) % 2 * 255).astype(np.uint8)[..., None], 3, axis=2)
    return str(textured_quad(Path("plane.glb"), checks, np.array([[0, 0], [1, 0], [1, 1], [0, 1]])))


def without_texture_file(name: str = "paint.png") -> str:
    file("toy.mtl", f"newmtl paint\nmap_Kd {name}\n".encode())
    vertices = [f"v {x} {y} {z}" for x, y, z in egg().vertices]
    faces = [f"f {a}/1 {b}/1 {c}/1" for a, b, c in egg().faces + 1]
    return file("toy.obj", "\n".join(["mtllib toy.mtl", "usemtl paint", *vertices, "vt 0 0", *faces]).encode())


def toy(*arguments: str) -> list[str]:
    return [painted("toy.ply"), *arguments]


def scene_file(old: str, new: str) -> list[str]:
    assert old in DEFAULT
    return toy("--scene", file("my.xml", DEFAULT.replace(old, new).encode()))


def picture() -> str:
    Image.new("RGB", (40, 40), "white").save("white.png")
    return "white.png@0,20"


# What is wrong: the arguments; what the message must name; what it must advise
BAD = {
    "missing file": (lambda: ["nowhere.glb"], r"no file nowhere\.glb", "bundled samples are strawberry"),
    "missing folder": (lambda: ["no/where.obj"], r"no/where\.obj", "bundled samples"),
    "a folder": (lambda: ["."], r"\. is a folder", "Check the spelling"),
    "a name without end": (lambda: ["a" * 300 + ".glb"], "File name too long", "Check the path"),
    "empty file": (lambda: [file("empty.glb")], r"empty\.glb is empty", "export it again"),
    "truncated GLB": (lambda: [truncated("cut.glb")], r"cut\.glb is truncated", "export it again"),
    "truncated PLY": (lambda: [truncated("cut.ply")], r"cut\.ply cannot be read as PLY", "export it again"),
    "truncated STL": (lambda: [truncated("cut.stl")], r"cut\.stl is truncated", "export it again"),
    "not a 3MF": (lambda: [file("text.3mf", b"solid nonsense")], r"text\.3mf cannot be read as 3MF", "export it again"),
    "not a GLB": (lambda: [file("text.glb", b"nonsense" * 9)], r"text\.glb is not glTF", "the download is complete"),
    "GLB without a mesh": (lambda: [str(Gltf().glb(Path("no.glb")))], r"no\.glb holds no triangles", "Export the mesh"),
    "NaN vertices": (lambda: [not_a_number()], r"nan\.ply has vertices that are not numbers", "Repair or export"),
    "plane": (lambda: [plane()], "plane .*sheet without thickness", "Solidify modifier"),
    "texture missing": (lambda: [without_texture_file()], r"toy\.obj uses the texture paint\.png, which is not", "Put"),
    "unknown format": (lambda: [file("toy.fbx", b"Kaydara")], r"toy\.fbx is of an unknown kind", r"Use one of \.glb"),
    "no suffix": (lambda: [file("toy", b"x")], r"unknown kind \(no suffix", r"Use one of \.glb"),
    "no texture": (lambda: [plain("plain.glb")], "plain has no texture", "--reference image.png@azimuth,elevation"),
    "reference without angles": (lambda: toy("--reference", "a.png"), r"'a\.png'", r"image\.png@azimuth,elevation in"),
    "reference missing": (lambda: toy("--reference", "a.png@0,0"), r"reference image a\.png", "No such file"),
    "reference of nothing": (lambda: toy("--reference", picture()), r"white\.png is empty", "everything in it is"),
    "no such scene": (lambda: toy("--scene", "my.xml"), r"no scene file my\.xml", "genmf-mi scene"),
    "scene of a device": (lambda: toy("--scene", "/dev/zero"), "/dev/zero is no XML file", "genmf-mi scene"),
    "unreadable XML": (lambda: scene_file("</scene>", ""), r"my\.xml is not readable as XML.*line \d+", "Fix it"),
    "XML with an unknown plugin": (lambda: scene_file('"multijitter"', '"magic"'), r"my\.xml.*magic", "Fix it"),
    "XML without twolight": (lambda: scene_file(BSDF, '<bsdf type="diffuse"/>'), r"my\.xml.*`twolight`", "genmf-mi"),
    "XML without views": (lambda: scene_file('name="views"', 'name="sights"'), r"my\.xml names no views", "add"),
    "size zero": (lambda: toy("--size-mm", "0"), "size-mm", "must be positive, not 0"),
    "size negative": (lambda: toy("--size-mm", "-5"), "size-mm", "must be positive, not -5"),
    "size not a number": (lambda: toy("--size-mm", "nan"), "size-mm", "must be a finite number, not nan"),
    "seed negative": (lambda: toy("--seed", "-1"), "seed must be 0 to", "not -1"),
    "resolution too large": (lambda: toy("--resolution", "60000"), "resolution must be 64 to 4096", "not 60000"),
    "reference of a device": (lambda: toy("--reference", "/dev/zero@0,0"), "reference image /dev/zero", "is no file"),
    "files elsewhere": (lambda: [without_texture_file("/etc/passwd")], "names /etc/passwd", "use --files-anywhere"),
    "cap negative": (lambda: toy("--max-relief-mm", "-0.1"), "max-relief-mm", r"cannot be negative \(-0\.1"),
    "cap too large": (lambda: toy("--max-relief-mm", "30"), "max-relief-mm 30", "lower it"),
    "weight negative": (lambda: toy("--gradient-sign", "-1"), "gradient-sign cannot be -1", "0 leaves the term out"),
    "too few faces": (lambda: toy("--max-faces", "12"), "max-faces", "at least 1000, not 12"),
    "output is a file": (lambda: toy("--out", file("results")), "results", "Choose another --out"),
    "output below a file": (lambda: toy("--out", file("results") + "/toy"), "results/toy", "Choose another --out"),
    "output below /proc": (lambda: toy("--out", "/proc/toy"), "/proc/toy", "Choose another --out"),
    "nothing to resume": (lambda: toy("--resume"), "runs/toy holds no interrupted run", "Start one without --resume"),
}  # fmt: skip


def printed_error(capsys) -> str:
    """The error that was printed: one line, alone on standard error."""
    captured = capsys.readouterr()
    assert "Traceback" not in captured.out + captured.err
    (line,) = captured.err.strip().splitlines()
    assert line.startswith("error: ") and line.endswith(".")
    assert 20 < len(line) < 420
    return line


def files_here() -> set[str]:
    """All files in the working folder and the folder for temporary files."""
    folders = Path("."), Path(tempfile.gettempdir())
    return {str(path) for folder in folders for path in folder.rglob("*") if path.is_file()}


def temporary_files() -> list[str]:
    """What was left in the folder for temporary files, but for the cache of torch, which its first optimizer makes."""
    return [name for name in os.listdir(tempfile.gettempdir()) if not name.startswith("torchinductor_")]


@pytest.mark.parametrize("name", BAD)
def test_is_one_line_and_exit_code_2(name, capsys, monkeypatch):
    """Refused before the long work, and without a trace but the settings."""
    make, named, advised = BAD[name]
    arguments, before = make(), files_here()
    monkeypatch.setattr(solid, "remesh", lambda *_: pytest.fail("this should have been refused before"))
    assert cli.main(["refine", *arguments]) == 2
    line = printed_error(capsys)
    assert re.search(named, line) and re.search(advised, line), line
    assert files_here() - before <= {f"runs/{Path(arguments[0]).stem}/config.yaml"}


def test_can_be_mended_and_tried_again(capsys, monkeypatch):
    """The failed attempt does not stand in the way of the next."""
    assert cli.main(["refine", *toy("--scene", "my.xml", "--quiet")]) == 2
    assert "my.xml" in printed_error(capsys)
    monkeypatch.setattr(refinement, "build_problem", lambda *_, **__: (_ for _ in ()).throw(KeyboardInterrupt))
    assert cli.main(["refine", "toy.ply"]) == cli.INTERRUPTED
    assert capsys.readouterr().err.splitlines()[-1] == "interrupted"


class TestMachine:
    @pytest.mark.parametrize(("found", "message"), [((15, 0, 7), r"LLVM 15\.0\.7"), (None, "there is no LLVM")])
    def test_llvm_too_old(self, found, message, capsys, monkeypatch):
        monkeypatch.setattr(variant, "llvm_version", lambda: found)
        assert cli.main(["refine", *toy("--device", "cpu")]) == 2
        line = printed_error(capsys)
        assert re.search(message, line) and "apt-get install libllvm" in line
        assert not Path("runs").exists()

    @pytest.mark.parametrize("arguments", [["refine", "toy.ply"], ["evaluate", "toy.ply", "toy.ply"]])
    def test_no_lpips_weights(self, arguments, capsys, monkeypatch):
        """They are fetched before the work begins; where that fails, nothing else does."""
        toy()
        monkeypatch.setenv("GENMF_LPIPS_WEIGHTS", "no weights")
        monkeypatch.setattr(
            weights, "missing", lambda: [n for n in weights.NETWORKS if not weights.weights_file(n).is_file()]
        )

        def unreachable() -> None:
            weights.require(*weights.NETWORKS)

        monkeypatch.setattr(lpips_conversion, "install", unreachable)
        for module in (refinement, evaluation):
            monkeypatch.setattr(module, "build_problem", lambda *_, **__: pytest.fail("this comes later"))
        assert cli.main(arguments) == 2
        line = printed_error(capsys)
        assert "are not in no weights" in line and "Run `genmf-mi weights`" in line
        perceptual._network.cache_clear()

    def test_no_gpu(self, capsys):
        if variant.cuda_available():
            pytest.skip("there is one")
        assert cli.main(["refine", *toy("--device", "cuda")]) == 2
        assert "--device cpu" in printed_error(capsys)

    def test_no_room_for_temporary_files(self, capsys, monkeypatch, full_disk):
        def full(*arguments, written=problem.bridge.write_ply, **options):
            with full_disk():
                return written(*arguments, **options)

        monkeypatch.setattr(problem.bridge, "write_ply", full)
        assert cli.main(["refine", *toy("--max-faces", "3000", "--edge-mm", "4")]) == 2
        assert re.search(r"\.ply: File too large\. Free some space, or point TMPDIR elsewhere", printed_error(capsys))
        assert temporary_files() == []

    def test_no_room_for_the_kernels_of_drjit(self, capfd, monkeypatch, full_disk):
        """They are compiled anew by the next run: not worth a line for each, among which an error would be lost."""
        import drjit
        import mitsuba as mi

        variant.use("cpu")
        drjit.sync_thread()
        with full_disk():
            x = drjit.arange(mi.Float, 1000)
            for factor in np.random.default_rng().random(100):  # no kernel of an earlier test
                x += drjit.sin(x * float(factor))
            assert np.isfinite(np.array(drjit.sum(x))).all()
        assert capfd.readouterr().err == ""


class TestOtherCommands:
    @pytest.mark.parametrize(
        ("arguments", "message"),
        [(["evaluate", "toy.ply", "nowhere.stl"], r"nowhere\.stl.*bundled samples"),
         (["evaluate", "nowhere.glb", "toy.ply"], r"nowhere\.glb.*bundled samples"),
         (["evaluate", "plain.glb", "toy.ply"], "plain has no texture"),
         (["evaluate", "toy.ply", "toy.ply", "--size-mm", "0"], "size-mm.*positive"),
         (["evaluate", "toy.ply", "toy.ply", "--scene", "my.xml"], r"no scene file my\.xml"),
         (["scene", "nowhere.glb"], r"nowhere\.glb.*bundled samples"),
         (["weights", "--from", "nowhere"], "nowhere does not exist.*genmf-mi weights"),
         (["weights", "--from", "toy.ply"], "toy.ply holds no LPIPS weights.*genmf-mi weights"),
         (["batch"], "name at least one asset"),
         (["batch", "a/toy.ply", "b/toy.ply"], "same file name.*Rename one")],
    )  # fmt: skip
    def test_says_what_is_wrong(self, arguments, message, capsys):
        toy()
        plain("plain.glb")
        assert cli.main(arguments) == 2
        assert re.search(message, printed_error(capsys))


def test_disk_full_while_writing(capsys, monkeypatch, two_views, full_disk):
    """While the 3MF is written. Nothing is lost: no temporary file stays, and the run can be finished."""
    for module, name, value in ((evaluator, "RESOLUTION", 64), (evaluator, "SAMPLES", 4), (target, "FINEST", 12_000),
                                (displacement, "AMPLITUDES", (0.5,))):  # fmt: skip
        monkeypatch.setattr(module, name, value)

    def full(*arguments, written=fabrication.write_3mf):
        with full_disk():
            written(*arguments)

    small = ["--iterations", "3", "--resolution", "96", "--max-faces", "3000", "--edge-mm", "4", "--device", "cpu"]
    arguments = ["refine", *toy(*small, "--no-score-vgg", "--no-stress", "--scene", str(two_views), "--quiet")]
    with monkeypatch.context() as patch:
        patch.setattr(fabrication, "write_3mf", full)
        assert cli.main(arguments) == 2
    assert re.search(r"runs/toy/refined\.3mf: File too large\. Free some space", printed_error(capsys))
    assert set(os.listdir("runs/toy")) == {CHECKPOINT, "metrics.jsonl", "config.yaml", "preview.png"}
    assert temporary_files() == []

    assert cli.main([*arguments, "--resume"]) == 0
    assert set(os.listdir("runs/toy")) == {
        "metrics.jsonl", "config.yaml", "metrics.json", "refined.3mf", "refined.stl", "refined.glb", "report.html",
        "before_after.png"}  # fmt: skip
    captured = capsys.readouterr()
    assert captured.err == ""
    assert "watertight" in captured.out and "runs/toy/refined.3mf" in captured.out
    assert re.search(r"before .*\n.*displacement .*\n.*after ", captured.out)

"""Every `genmf-mi` command on the pages is executed, page by page: on a small painted shape that bears the names of the
files, with few iterations, small pictures and coarse meshes. What a command needs of an earlier one is on its page.

That takes seven minutes: it is done before a release (`make release-check`), or where GENMF_TEST_COMMANDS is set. That
the arguments fit is tested always (test_commands.py).
"""

from __future__ import annotations

import json
import os
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest
import test_commands as pages
import trimesh
from gltf_writer import Gltf
from PIL import Image
from toys import painted

from genmf_mi.assets.generators import from_mesh
from genmf_mi.cli import main as cli
from genmf_mi.pipeline import as_printed
from genmf_mi.stress.report import verification

pytestmark = [
    pytest.mark.usefixtures("small_refinements"),
    pytest.mark.skipif(
        not os.environ.get("GENMF_TEST_COMMANDS"),
        reason="GENMF_TEST_COMMANDS is not set; with it, all commands of the pages are executed in seven minutes",
    ),
]

SMALL = ["--iterations", "2", "--resolution", "64", "--samples", "1", "--max-faces", "6000", "--edge-mm", "4",
         "--device", "cpu"]  # fmt: skip
SIZE = ["--size-mm", "40"]
"""Of parts whose layers are counted."""
COARSE = ["--edge-mm", "12", "--grid", "33", "--force"]
ELSEWHERE = {
    "ui": "it serves until it is stopped: tests/ui",
    "weights": "tests/cli/test_weights_command.py",
    "ray": "it needs a cluster: tests/batch/test_ray.py",
}
"""Commands that other tests execute, and where."""


@pytest.fixture
def files(workplace, coarse_warpage, monkeypatch) -> Path:
    """A folder with the files that the pages name, and small pictures of what is printed."""
    parts_of_materials(Path("bus"))
    for name in ("chair", "vase", "teacup", "bust"):
        painted(f"{name}.glb")
    for name in ("scan.obj", "bust.stl", "painted.ply"):
        painted(name)
    Path("assets").mkdir()
    for name in ("one", "two", "three"):
        shutil.copy("bus.glb", f"assets/{name}.glb")
    Path("list.csv").write_text("asset\nassets/one.glb\nassets/two.glb\nassets/three.glb\n")
    strokes = [{"kind": "flat", "points": [[0, 0, 0.9]], "normals": [[0, 0, 1]], "radius_mm": 15}]
    Path("bus.regions.json").write_text(json.dumps({"format": "genmf-regions", "version": 1, "strokes": strokes}))
    picture = Image.fromarray(np.uint8(np.add.outer(np.arange(64), np.arange(64)) % 32 * 8))
    for name in ("front.png", "side.png", "mask.png"):
        picture.convert("RGB").save(name)
    for name, number in (("ID", 1), ("MIN", 1), ("MAX", 2), ("COUNT", 2), ("STEP", 1)):
        monkeypatch.setenv(f"SLURM_ARRAY_TASK_{name}", str(number))
    monkeypatch.setattr(from_mesh.sdf_from_mesh, "__defaults__", (33, None))
    monkeypatch.setattr(as_printed, "RESOLUTION", 64)
    monkeypatch.setattr(as_printed, "SAMPLES_LAMPS", 2)
    monkeypatch.setattr(verification, "EDGE_MM", 12.0)
    monkeypatch.setattr("genmf_mi.stress.fem.body_mesh.FINEST", 0.2)
    return workplace


def parts_of_materials(path: Path) -> None:
    """A ball as OBJ and as GLB: quarters of other materials, which are groups in the OBJ and have texture coordinates
    and vertex colours in the GLB."""
    ball = trimesh.creation.icosphere(3)
    quarters = np.array_split(ball.faces[np.argsort(ball.triangles_center[:, 2])], 4)
    names, groups = ("paint", "signs", "glass", "chrome"), ("body", "boards", "windows", "wheels")
    colours = ((0.8, 0.2, 0.2), (0.9, 0.9, 0.2), (0.1, 0.1, 0.1), (0.9, 0.9, 0.9))
    path.with_suffix(".mtl").write_text(
        "".join(f"newmtl {name}\nKd {r} {g} {b}\n" for name, (r, g, b) in zip(names, colours, strict=True))
    )
    lines = [f"mtllib {path.stem}.mtl", *(f"v {x} {y} {z}" for x, y, z in ball.vertices)]
    gltf, x, y, z = Gltf(), *ball.vertices.T
    attributes = {
        "POSITION": gltf.accessor(np.float32(ball.vertices)),
        "TEXCOORD_0": gltf.accessor(np.float32(np.column_stack([np.arctan2(x, z) / (2 * np.pi) + 0.5, y / 2 + 0.5]))),
        "COLOR_0": gltf.accessor(np.float32(np.where(np.sin(9 * y)[:, None] > 0, [1, 1, 1], [0.5, 0.5, 0.5]))),
    }
    primitives = []
    for i, (name, group, faces) in enumerate(zip(names, groups, quarters, strict=True)):
        lines += [f"g {group}", f"usemtl {name}", *(f"f {a} {b} {c}" for a, b, c in faces + 1)]
        primitives.append({"attributes": attributes, "indices": gltf.accessor(np.uint32(faces.ravel())), "material": i})
    path.with_suffix(".obj").write_text("\n".join(lines))
    gltf.tree["materials"] = [
        {"name": name, "pbrMetallicRoughness": {"baseColorFactor": [*colour, 1]}}
        for name, colour in zip(names, colours, strict=True)
    ]
    gltf.mesh(*primitives).glb(path.with_suffix(".glb"))


def smaller(arguments: list[str]) -> list[str]:
    """The same command with less work, and with its output in the working folder."""
    arguments = [word.removeprefix("/shared/") for word in arguments]
    command = arguments[0]
    if command == "refine":
        return [*arguments, *SMALL, "--force", *SIZE * ("--size-mm" not in arguments)]
    if command in ("batch", "sweep"):
        own = [word for word in arguments if not word.startswith("--arguments")]
        given = [word.partition("=")[2] for word in arguments if word.startswith("--arguments")]
        inline = ["--engine", "inline"] if command == "batch" else []
        return [*own, *inline, "--force", f"--arguments={' '.join([*given, *SMALL])}"]
    if command == "convert":
        return [*arguments, "--samples", "33"]
    return [*arguments, *COARSE] if arguments[:2] == ["stress", "simulate"] else arguments


def run(arguments: list[str], capfd) -> None:
    """The command; what it said is in the message if it fails."""
    try:
        code = cli.main(arguments)
    except SystemExit as ended:
        code = ended.code
    assert not code, f"genmf-mi {shlex.join(arguments)} ended with {code}:\n{capfd.readouterr().err[-2000:]}"


@pytest.mark.parametrize("page", [page for page in pages.PAGES if pages.ours(page)], ids=lambda page: page.name)
def test_commands_run(page, files, capfd):
    for arguments in pages.ours(page):
        if ELSEWHERE.keys() & set(arguments):
            continue
        if "chair.npz" in arguments and not Path("chair.npz").exists():
            run(smaller(["convert", "chair.glb", "--out", "chair.npz"]), capfd)
        run(smaller(arguments), capfd)

"""Names that are no UTF-8, no plain text, or spelled as another system does: read, mended, and written."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
import trimesh
from gltf_writer import QUAD, QUAD_FACES, Gltf
from PIL import Image
from toy_runs import CONFIG
from toys import egg, painted

import genmf_mi
from genmf_mi.assets import asset
from genmf_mi.cli.refine import print_result
from genmf_mi.core.errors import AssetError
from genmf_mi.core.text import printable

RAW = os.fsdecode(b"caf\xe9 \xff")


@pytest.mark.parametrize(
    ("given", "written"),
    [
        ("bus", "bus"),
        ("名前 ñ 🙂", "名前 ñ 🙂"),
        (RAW, "café ÿ"),
        ("a\nb\x00c\x1b[31m\x9b", "a b c [31m "),
        ("\ud800\ufffe", "\N{REPLACEMENT CHARACTER}" * 2),
    ],
)
def test_printable(given, written):
    assert printable(given) == written
    written.encode("utf-8")


@pytest.mark.parametrize("suffix", [".glb", ".obj", ".ply", ".stl", ".3mf"])
def test_files_whose_names_are_no_utf_8(tmp_path, suffix):
    whole = tmp_path / f"egg{suffix}"
    egg().export(whole) if suffix in (".stl", ".3mf") else painted(whole)
    path = tmp_path / (RAW + suffix)
    shutil.copy(whole, path)
    found = asset.load(path)
    assert found.name == "café ÿ" and len(found.faces) == 1280


def test_a_file_that_is_not_there_is_named_in_any_case(tmp_path, capfd):
    from genmf_mi.cli.main import main

    assert main(["refine", str(tmp_path / (RAW + ".glb"))]) == 2
    assert "there is no file" in capfd.readouterr().err


def textured_obj(folder: Path, picture: bytes, named: bytes) -> Path:
    """A triangle whose material names its texture ``named``, in files of that encoding; it is called ``picture``."""
    encoding = "latin-1" if b"\xe9" in named else "utf-8"
    corners = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\n"
    text = f"mtllib a.mtl\no Würfel\n{corners}usemtl hölz\nf 1/1 2/2 3/3\n"
    (folder / "a.obj").write_bytes(text.encode(encoding))
    (folder / "a.mtl").write_bytes("newmtl hölz\nmap_Kd ".encode(encoding) + named + b"\n")
    Image.new("RGB", (2, 2), (255, 0, 0)).save(folder / "made.png")
    (folder / "made.png").rename(folder / os.fsdecode(picture))
    return folder / "a.obj"


@pytest.mark.parametrize(
    ("picture", "named"),
    [
        (b"caf\xe9.png", b"caf\xe9.png"),  # Latin-1 in the archive and in the file
        ("café.png".encode(), b"caf\xe9.png"),
        (b"caf\xe9.png", "café.png".encode()),
        ("cafe\u0301.png".encode(), "café.png".encode()),  # macOS
    ],
)
def test_textures_are_found_however_accents_are_written(tmp_path, picture, named):
    found = asset.load(textured_obj(tmp_path, picture, named))
    np.testing.assert_allclose(found.closest_albedo(np.array([[0.2, 0.2, 0]])), [[1, 0, 0]], atol=1e-6)


class TestGltf:
    def file(self, path: Path, uri: str | None = None) -> Path:
        gltf = Gltf()
        attributes = {"POSITION": gltf.accessor(QUAD), "TEXCOORD_0": gltf.accessor(QUAD[:, :2].copy())}
        gltf.tree |= {
            "images": [{"uri": uri}] if uri else [{"bufferView": gltf.view(b"?"), "mimeType": "image/png"}],
            "textures": [{"source": 0}],
            "materials": [{"name": "MATERIAL", "normalTexture": {"index": 0}}],
        }
        gltf.mesh({"attributes": attributes, "indices": gltf.accessor(QUAD_FACES), "material": 0})
        gltf.tree["nodes"][0]["name"] = "NODE"
        gltf.glb(path)
        path.write_bytes(path.read_bytes().replace(b"MATERIAL", b"m\xfcteri\xe4l").replace(b"NODE", b"n\xf6d\xff"))
        return path

    def test_names_that_are_no_utf_8_cost_nothing(self, tmp_path):
        found = asset.load(self.file(tmp_path / "a.glb"))
        assert len(found.faces) == 2
        (note,) = found.notes
        assert "müteriäl" in note
        note.encode("utf-8")

    def test_escaped_bytes_of_an_image(self, tmp_path):
        pixels = np.full((2, 2, 3), (228, 128, 200), np.uint8)
        Image.fromarray(pixels).save(tmp_path / "made.png")
        (tmp_path / "made.png").rename(tmp_path / os.fsdecode(b"caf\xe9.png"))
        assert asset.load(self.file(tmp_path / "a.glb", "caf%E9.png")).maps

    def test_what_is_no_text_at_all_is_refused(self, tmp_path):
        (tmp_path / "a.gltf").write_bytes(b"\xff\xfe\x00{")
        with pytest.raises(AssetError, match="not glTF"):
            asset.load(tmp_path / "a.gltf")


def test_text_of_a_3mf_that_is_no_utf_8_costs_nothing(tmp_path):
    import zipfile

    egg().export(tmp_path / "egg.3mf")
    with zipfile.ZipFile(tmp_path / "egg.3mf") as old, zipfile.ZipFile(tmp_path / "bad.3mf", "w") as new:
        for member in old.namelist():
            data = old.read(member)
            new.writestr(member, data.replace(b"<resources>", b'<metadata name="Title">\xff\xe9</metadata><resources>'))
    assert len(asset.load(tmp_path / "bad.3mf").faces) == 1280


def test_a_whole_run_and_what_is_printed(small_refinements, two_views, tmp_path, capfd):
    """All files are there, text is Unicode, and brackets of a name are no markup."""
    path = tmp_path / (RAW + " [b] [red].glb")
    painted(tmp_path / "egg.glb")
    shutil.copy(tmp_path / "egg.glb", path)
    out = tmp_path / RAW
    config = genmf_mi.RefineConfig(**{**vars(CONFIG), "iterations": 2})
    result = genmf_mi.refine(path, config, scene=two_views, out=out)
    print_result(result.metrics, out)
    shown = capfd.readouterr().out
    assert "café ÿ [b] [red]" in shown
    assert json.loads((out / "metrics.json").read_text(encoding="utf-8"))["asset"] == "café ÿ [b] [red]"
    assert "café ÿ [b] [red]" in (out / "report.html").read_text(encoding="utf-8")
    for name in ("refined.3mf", "refined.glb"):
        assert len(trimesh.load_mesh(shutil.copy(out / name, tmp_path / name), process=False).faces) > 100

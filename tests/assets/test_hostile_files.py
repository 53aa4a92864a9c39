"""Files that are damaged or made to harm, of every format: refused by name, before memory and minutes are taken."""

from __future__ import annotations

import io
import os
import struct
import tracemalloc
import zlib
from pathlib import Path

import numpy as np
import pytest
from gltf_writer import QUAD, QUAD_FACES, Gltf, textured_quad
from PIL import Image

from genmf_mi.assets import asset, part, sources
from genmf_mi.assets.reading import reading
from genmf_mi.core.errors import AssetError
from genmf_mi.render import target

UNIT_UV = QUAD[:, :2] * [1, -1] + [0, 1]


def obj(path: Path, *head: str, corner: str = "1 1 1", uv: str = "1 1") -> Path:
    """A tetrahedron whose last corner and texture coordinate are given."""
    lines = [*head, "v 0 0 0", "v 1 0 0", "v 0 1 0", f"v {corner}", "vt 0 0", "vt 1 0", "vt 0 1", f"vt {uv}"]
    path.write_text("\n".join([*lines, "f 1/1 3/3 2/2", "f 1/1 2/2 4/4", "f 2/2 3/3 4/4", "f 3/3 1/1 4/4"]))
    return path


def ply(path: Path, *comments: str) -> Path:
    """A triangle with texture coordinates."""
    head = ["ply", "format ascii 1.0", *comments, "element vertex 3", *(f"property float {c}" for c in "xyzst"),
            "element face 1", "property list uchar int vertex_indices", "end_header"]  # fmt: skip
    path.write_text("\n".join([*head, "0 0 0 0 0", "1 0 0 1 0", "0 1 0 0 1", "3 0 1 2", ""]))
    return path


def bomb(width: int, height: int) -> bytes:
    """A PNG of a few bytes that tells of many pixels."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(b"")) + chunk(b"IEND", b"")


class TestCoordinates:
    @pytest.mark.parametrize("number", ["1e16", "1e30", "1e100", "1e200", "1e308"])
    def test_huge_ones(self, tmp_path, number):
        with pytest.raises(AssetError, match=r"coordinates of \de\+\d+\. Scale it down"):
            asset.load(obj(tmp_path / "a.obj", corner=f"{number} 1 1"))

    @pytest.mark.parametrize("scale", [1e-45, 1e-31])
    def test_tiny_ones(self, tmp_path, scale):
        """Files of 32-bit floats round them to nothing."""
        path = tmp_path / "a.obj"
        path.write_text(f"v 0 0 0\nv {scale} 0 0\nv 0 {scale} 0\nf 1 2 3\n")
        with pytest.raises(AssetError, match=r"is 1e-\d+ units large.* Scale it up"):
            asset.load(path)

    @pytest.mark.parametrize("number", ["nan", "inf", "1e999"])
    def test_none(self, tmp_path, number):
        with pytest.raises(AssetError, match="not numbers"):
            asset.load(obj(tmp_path / "a.obj", corner=f"{number} 1 1"))
        (tmp_path / "a.mtl").write_text("newmtl m\nmap_Kd a.png")
        Image.new("RGB", (4, 4)).save(tmp_path / "a.png")
        with pytest.raises(AssetError, match="texture coordinates that are not numbers"):
            asset.load(obj(tmp_path / "a.obj", "mtllib a.mtl", "usemtl m", uv=f"{number} 1"))

    @pytest.mark.parametrize("number", ["nan", "inf", "1e999"])
    def test_vertex_colours_that_are_none(self, tmp_path, number):
        corners = ["0 0 0 1 0 0", f"1 0 0 0 {number} 0", "0 1 0 0 0 1"]
        path = tmp_path / "a.obj"
        path.write_text("".join(f"v {corner}\n" for corner in corners) + "f 1 2 3\n")
        with pytest.raises(AssetError, match="colours that are not numbers"):
            asset.load(path)

    @pytest.mark.parametrize("colour", ["Kd nan 0 0", "Kd inf 0 0"])
    def test_colours_that_are_none(self, tmp_path, colour):
        (tmp_path / "a.mtl").write_text(f"newmtl m\n{colour}")
        with pytest.raises(AssetError, match="Kd that is not three numbers"):
            asset.load(obj(tmp_path / "a.obj", "mtllib a.mtl", "usemtl m"))


class TestFilesElsewhere:
    """Only regular files below the folder of the asset are read, unless the user allows others."""

    @pytest.fixture
    def home(self, tmp_path) -> Path:
        """A folder, with a library and a picture beside it."""
        Image.new("RGB", (4, 4), "red").save(tmp_path / "other.png")
        (tmp_path / "other.mtl").write_text("newmtl m\nmap_Kd other.png")
        (tmp_path / "home").mkdir()
        os.mkfifo(tmp_path / "pipe")
        return tmp_path / "home"

    @pytest.mark.parametrize("name", ["../other.png", "/etc/passwd", "/dev/zero", "../pipe"])
    def test_a_texture_of_a_ply(self, home, name):
        with pytest.raises(AssetError, match=r"not below its own folder.*--files-anywhere"):
            asset.load(ply(home / "a.ply", f"comment TextureFile {name}"))

    def test_allowed(self, home):
        found = sources.load(ply(home / "a.ply", "comment TextureFile ../other.png"), files_anywhere=True)
        assert found.textured
        found = asset.load(obj(home / "a.obj", "mtllib ../other.mtl", "usemtl m"), files_anywhere=True)
        assert found.textured
        absolute = home.parent / "other.png"
        assert asset.load(ply(home / "a.ply", f"comment TextureFile {absolute}"), files_anywhere=True).textured

    @pytest.mark.parametrize("name", ["/dev/zero", "../pipe", "../home"])
    def test_no_special_file_ever(self, home, name):
        with pytest.raises(AssetError, match="which is no file"):
            asset.load(ply(home / "a.ply", f"comment TextureFile {name}"), files_anywhere=True)

    def test_links_out_of_the_folder(self, home):
        (home / "a.png").symlink_to(home.parent / "other.png")
        with pytest.raises(AssetError, match="not below its own folder"):
            asset.load(ply(home / "a.ply", "comment TextureFile a.png"))
        assert asset.load(ply(home / "a.ply", "comment TextureFile a.png"), files_anywhere=True).textured


class TestPictures:
    @pytest.mark.parametrize(
        ("size", "message"), [((16384, 16384), "too many|16384 × 16384"), ((2**31 - 1,) * 2, "too")]
    )
    def test_bombs(self, tmp_path, size, message):
        (tmp_path / "a.png").write_bytes(bomb(*size))
        with pytest.raises(AssetError, match=message):
            asset.load(ply(tmp_path / "a.ply", "comment TextureFile a.png"))
        with pytest.raises(AssetError, match="reference image"):
            target.read_picture(f"{tmp_path / 'a.png'}@0,0")

    def test_references_that_are_no_pictures(self, tmp_path):
        os.mkfifo(tmp_path / "pipe")
        for name in ("/dev/zero", tmp_path / "pipe", tmp_path):
            with pytest.raises(AssetError, match="is no file"):
                target.read_picture(f"{name}@0,0")

    def test_a_large_reference_is_scaled_down(self, tmp_path):
        picture = Image.new("RGBA", (5000, 3000))
        picture.paste((200, 100, 50, 255), (1000, 1000, 4000, 2000))
        picture.save(tmp_path / "a.png")
        rgba = target.read_picture(f"{tmp_path / 'a.png'}@0,0").rgba
        assert max(rgba.shape) <= target.MOST_PIXELS and rgba[..., 3].mean() == pytest.approx(0.2, abs=0.01)
        assert np.ptp(rgba[..., 0][rgba[..., 3] > 0.5]) < 0.01

    def test_sixteen_bits_take_no_more_than_they_hold(self):
        stream = io.BytesIO()
        deep = (np.arange(2048, dtype=np.uint16) * 32)[:, None].repeat(2048, axis=1)
        Image.fromarray(deep).save(stream, "PNG")
        tracemalloc.start()
        pixels = part.decode_image(stream.getvalue(), "deep")
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert pixels.shape == (2048, 2048, 3) and np.array_equal(pixels[:, 5, 1], np.arange(2048) * 32 // 257)
        assert peak < 8 * deep.size

    def test_one_picture_of_many_materials_is_kept_once(self, monkeypatch):
        stream = io.BytesIO()
        Image.new("RGB", (64, 64), "red").save(stream, "PNG")
        other = io.BytesIO()
        Image.new("RGB", (64, 64), "blue").save(other, "PNG")
        monkeypatch.setattr("genmf_mi.assets.reading.MOST_PIXELS", 5000)
        with reading():
            assert part.decode_image(stream.getvalue(), "a") is part.decode_image(stream.getvalue(), "b")
            with pytest.raises(AssetError, match="too large together, from c on"):
                part.decode_image(other.getvalue(), "c")

    def test_programs_are_not_called(self, tmp_path):
        """Pillow has Ghostscript read EPS, whatever the file is called."""
        (tmp_path / "a.png").write_bytes(b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n%%EndComments\n")
        with pytest.raises(AssetError, match="cannot be decoded"):
            asset.load(ply(tmp_path / "a.ply", "comment TextureFile a.png"))


class TestCounts:
    def test_an_array_without_data_is_no_longer_than_another(self, tmp_path):
        gltf = Gltf()
        position = gltf.accessor(QUAD)
        gltf.mesh({"attributes": {"POSITION": position}, "indices": gltf.accessor(QUAD_FACES)})
        del gltf.tree["accessors"][position]["bufferView"]
        gltf.tree["accessors"][position]["count"] = 40_000_000
        with pytest.raises(AssetError, match="damaged: it asks for 40000000"):
            asset.load(gltf.glb(tmp_path / "a.glb"))

    def test_a_mesh_that_is_placed_without_end(self, tmp_path, monkeypatch):
        path = textured_quad(tmp_path / "a.glb", np.zeros((2, 2, 3), np.uint8), UNIT_UV)
        monkeypatch.setattr("genmf_mi.assets.reading.MOST_FACES", 1)
        with pytest.raises(AssetError, match="Simplify it"):
            asset.load(path)

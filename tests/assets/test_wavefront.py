"""OBJ and MTL: options, several libraries and materials, and what must not be lost in silence."""

from __future__ import annotations

import os

import numpy as np
import pytest
import trimesh
from PIL import Image

from genmf_mi.assets import asset
from genmf_mi.core.colour import to_linear
from genmf_mi.core.errors import AssetError

SQUARE = """
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
vt 0 0
vt 1 0
vt 1 1
vt 0 1
"""
FOUR = (np.array([[[1, 0, 0], [0, 1, 0]], [[0, 0, 1], [1, 1, 1]]]) * 255).astype(np.uint8)


@pytest.fixture
def square(tmp_path):
    """Writes ``square.obj`` with a textured material whose ``map_Kd`` statement is given, and reads it."""
    Image.fromarray(FOUR).save(tmp_path / "four colours.png")

    def make(statement: str, kd: str = "Kd 0 0 0") -> asset.Asset:
        (tmp_path / "square.mtl").write_text(f"newmtl skin\n{kd}\n{statement}\n")
        faces = "mtllib square.mtl\nusemtl skin\nf 1/1 2/2 3/3\nf 1/1 3/3 4/4\n"
        (tmp_path / "square.obj").write_text(SQUARE + faces)
        return asset.load(tmp_path / "square.obj")

    return make


def at(found: asset.Asset, x: float, y: float) -> np.ndarray:
    return found.closest_albedo(np.array([[x, y, 0.0]]))[0]


def test_picture_stands_upright_and_kd_is_left_out(square):
    found = square("map_Kd four colours.png")
    assert found.textured
    np.testing.assert_allclose(at(found, 0.25, 0.75), [1, 0, 0], atol=1e-6)
    np.testing.assert_allclose(at(found, 0.75, 0.25), [1, 1, 1], atol=1e-6)


def test_scale_offset_and_clamp(square):
    found = square("map_Kd -s 2 1 1 -o 0.5 0 -clamp on four colours.png")
    # u' = 2u + 0.5 leaves the picture at u = 0.25 and then holds its right column.
    np.testing.assert_allclose(at(found, 0.125, 0.75), [0, 1, 0], atol=1e-6)
    np.testing.assert_allclose(at(found, 0.9, 0.75), [0, 1, 0], atol=1e-6)
    # v' = v/2 over the whole square shows the lower half of the picture, its upper edge in the middle of the picture.
    found = square("map_Kd -s 1 0.5 1 four colours.png")
    np.testing.assert_allclose(at(found, 0.25, 0.5), [0, 0, 1], atol=1e-6)
    np.testing.assert_allclose(at(found, 0.25, 1.0), [0.5, 0, 0.5], atol=1e-6)


def test_windows_paths(square, tmp_path):
    (tmp_path / "maps").mkdir()
    Image.fromarray(FOUR).save(tmp_path / "maps" / "a.png")
    np.testing.assert_allclose(at(square("map_Kd maps\\a.png"), 0.75, 0.75), [0, 1, 0], atol=1e-6)


def test_missing_texture_is_an_error(square):
    with pytest.raises(AssetError, match=r"gone\.png, which is not beside it"):
        square("map_Kd gone.png")


def test_undecodable_texture_is_an_error(square, tmp_path):
    (tmp_path / "bad.png").write_bytes(b"not a picture")
    with pytest.raises(AssetError, match=r"bad\.png cannot be decoded"):
        square("map_Kd bad.png")


def test_missing_material_library_is_an_error(tmp_path):
    (tmp_path / "a.obj").write_text(SQUARE + "mtllib gone.mtl\nusemtl skin\nf 1/1 2/2 3/3\n")
    with pytest.raises(AssetError, match=r"gone\.mtl, which are not beside it"):
        asset.load(tmp_path / "a.obj")


def test_plain_colours_of_two_libraries(tmp_path):
    (tmp_path / "a.mtl").write_text("newmtl first\nKd 0.5 0.5 0.5\n")
    (tmp_path / "b.mtl").write_text("newmtl second\nKd 1 0 0\n")
    (tmp_path / "a.obj").write_text(
        SQUARE + "mtllib a.mtl\nmtllib b.mtl\nusemtl first\nf 1 2 3\nusemtl second\nf 1 3 4\n"
    )
    found = asset.load(tmp_path / "a.obj")
    assert found.textured
    np.testing.assert_allclose(at(found, 0.9, 0.1), to_linear(0.5), rtol=1e-6)
    np.testing.assert_allclose(at(found, 0.1, 0.9), [1, 0, 0], atol=1e-6)


def test_coloured_vertices_are_srgb(tmp_path):
    (tmp_path / "a.obj").write_text(
        "v 0 0 0 0.5 0.5 0.5\nv 1 0 0 0.5 0.5 0.5\nv 0 1 0 0.5 0.5 0.5\nv 1 1 0 1 0 0\nf 1 2 3\nf 2 4 3\n"
    )
    found = asset.load(tmp_path / "a.obj")
    np.testing.assert_allclose(at(found, 0.2, 0.2), to_linear(0.5), atol=1e-6)
    np.testing.assert_allclose(at(found, 1, 1), [1, 0, 0], atol=1e-6)


def test_coloured_vertices_survive_texture_coordinates_and_materials(tmp_path):
    (tmp_path / "a.mtl").write_text("newmtl plain\nKd 0.8 0.8 0.8\n")
    (tmp_path / "a.obj").write_text(
        "mtllib a.mtl\nusemtl plain\nv 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 0 1 0 0 0 1\nvt 0 0\nf 1/1 2/1 3/1\n"
    )
    found = asset.load(tmp_path / "a.obj")
    np.testing.assert_allclose(found.closest_albedo(found.vertices), np.eye(3), atol=1e-6)


def test_quads_negative_indices_and_groups(tmp_path):
    (tmp_path / "a.obj").write_text(SQUARE + "g one\nf -4//1 -3//1 \\\n -2//1 -1//1 # a square\ng two\nf 1 2 3\n")
    found = asset.load(tmp_path / "a.obj")
    corner = found.vertices[found.faces]
    areas = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])[:, 2] / 2
    np.testing.assert_allclose(areas, 0.5)
    assert len(found.faces) == 3


class TestAsExportersWrite:
    """Nothing of the look may depend on how a program puts blanks, quotes, cases and marks."""

    @pytest.mark.parametrize(
        "library",
        [
            "newmtl\tskin\n\tmap_Kd\tfour colours.png\n",
            "\ufeffnewmtl skin\nmap_Kd four colours.png\n",
            'newmtl "skin"\nmap_Kd "four colours.png"\n',
            "  NEWMTL   skin\n  MAP_KD   FOUR COLOURS.PNG\n",
            "newmtl skin\r\nmap_Kd C:\\work\\textures\\four colours.png\r\n",
            "newmtl skin\nmap_Kd -blendu on -o 0 0 0 four colours.png\n",
            "newmtl skin\nKd 0.1 0.2 0.3\nmap_Kd ./four colours.png",
        ],
    )
    @pytest.mark.parametrize("use", ["mtllib square.mtl\nusemtl skin", "\ufeffmtllib\tSquare.MTL\n\tusemtl\tskin "])
    def test_texture_is_found(self, tmp_path, library, use):
        Image.fromarray(FOUR).save(tmp_path / "four colours.png")
        (tmp_path / "square.mtl").write_text(library, encoding="utf-8")
        faces = "\nf 1/1 2/2 3/3\n\tF 1/1 3/3 4/4\n"
        mark = "\ufeff" if use.startswith("\ufeff") else ""
        (tmp_path / "square.obj").write_text(mark + SQUARE + use.lstrip("\ufeff") + faces, encoding="utf-8")
        found = asset.load(tmp_path / "square.obj")
        assert len(found.faces) == 2
        np.testing.assert_allclose(at(found, 0.75, 0.75), [0, 1, 0], atol=1e-6)

    def test_apostrophes_and_blanks_in_names(self, tmp_path):
        Image.fromarray(FOUR).save(tmp_path / "it's  mine.png")
        (tmp_path / "my materials.mtl").write_text("newmtl Bob's  skin\nmap_Kd it's  mine.png\n")
        text = SQUARE + "mtllib my materials.mtl\nusemtl Bob's skin\nf 1/1 2/2 3/3 4/4\n"
        (tmp_path / "a.obj").write_text(text)
        np.testing.assert_allclose(at(asset.load(tmp_path / "a.obj"), 0.75, 0.75), [0, 1, 0], atol=1e-6)

    def test_several_libraries_on_one_line(self, tmp_path):
        for name, kd in (("a", "1 0 0"), ("b", "0 1 0")):
            (tmp_path / f"{name}.mtl").write_text(f"newmtl {name}\nKd {kd}\n")
        text = SQUARE + "mtllib a.mtl b.mtl\nusemtl a\nf 1 2 3\nusemtl b\nf 1 3 4\n"
        (tmp_path / "a.obj").write_text(text)
        found = asset.load(tmp_path / "a.obj")
        np.testing.assert_allclose(at(found, 0.75, 0.25), [1, 0, 0], atol=1e-6)
        np.testing.assert_allclose(at(found, 0.25, 0.75), [0, 1, 0], atol=1e-6)

    @pytest.mark.parametrize("line", ["v 1 two 3", "f 1 x 3", "vt", "v 1 2"])
    def test_what_cannot_be_understood_is_shown(self, tmp_path, line):
        (tmp_path / "a.obj").write_text(SQUARE + line + "\nf 1 2 3\n")
        with pytest.raises(AssetError, match=r"line 10 of .*a\.obj|less than three coordinates"):
            asset.load(tmp_path / "a.obj")

    @pytest.mark.parametrize("kd", ["nan 0 0", "1 2", "red", "inf 0 0"])
    def test_colours_that_are_not_numbers(self, square, kd):
        with pytest.raises(AssetError, match="not three numbers"):
            square("", f"Kd {kd}")


class TestPolygons:
    @pytest.mark.parametrize("turn", [(0, 1, 2), (1, 2, 0), (2, 0, 1), (1, 0, 2)])
    def test_a_concave_one_is_filled_within(self, tmp_path, turn):
        """A comb with three teeth, in every plane and both ways round: a prism has the volume of its outline."""
        outline = [(0, 0), (5, 0), (5, 3), (4, 3), (4, 1), (3, 1), (3, 3), (2, 3), (2, 1), (1, 1), (1, 3), (0, 3)]
        count = len(outline)
        points = np.array([(x, y, z) for z in (0, 2) for x, y in outline], dtype=float)[:, turn]
        faces = [list(range(count, 2 * count)), list(range(count))[::-1]]
        faces += [[i, (i + 1) % count, count + (i + 1) % count, count + i] for i in range(count)]
        rows = [f"v {x} {y} {z}" for x, y, z in points]
        rows += ["f " + " ".join(str(i + 1) for i in face) for face in faces]
        (tmp_path / "comb.obj").write_text("\n".join(rows))
        found = asset.load(tmp_path / "comb.obj")
        mesh = trimesh.Trimesh(found.vertices, found.faces)
        area, around = 5 + 3 * 2, 5 + 2 * 3 + 3 + 4 * 2 + 2
        assert mesh.is_watertight and abs(mesh.volume) == pytest.approx(2 * area)
        assert mesh.area == pytest.approx(2 * area + 2 * around)
        assert len(found.faces) == 2 * (count - 2) + 2 * count

    def test_degenerate_ones_do_no_harm(self, tmp_path):
        (tmp_path / "a.obj").write_text(SQUARE + "f 1 2 3 4\nf 1 2 1 2\nf 1 2\nf 1 1 1 1 1\n")
        assert len(asset.load(tmp_path / "a.obj").faces) >= 2


class TestFilesThatAreNamed:
    """Only regular files below the asset's own folder are read."""

    @pytest.fixture
    def naming(self, tmp_path):
        home = tmp_path / "home"
        home.mkdir()
        (tmp_path / "secret.mtl").write_text("newmtl skin\nKd 1 0 0\n")

        def make(name: str):
            (home / "a.obj").write_text(SQUARE + f"mtllib {name}\nusemtl skin\nf 1 2 3\n")
            return asset.load(home / "a.obj")

        return home, make

    @pytest.mark.parametrize("name", ["/dev/zero", "/etc/passwd", "../secret.mtl"])
    def test_others_are_refused_by_name(self, naming, name):
        with pytest.raises(AssetError, match="not below its own folder"):
            naming[1](name)

    def test_so_are_links_that_lead_out(self, naming, tmp_path):
        home, make = naming
        (home / "link.mtl").symlink_to(tmp_path / "secret.mtl")
        with pytest.raises(AssetError, match="not below its own folder"):
            make("link.mtl")

    def test_pipes_do_not_hang(self, naming):
        home, make = naming
        os.mkfifo(home / "pipe.mtl")
        with pytest.raises(AssetError, match="is no file"):
            make("pipe.mtl")

    def test_what_is_missing_is_said(self, naming):
        with pytest.raises(AssetError, match="not beside it"):
            naming[1]("gone.mtl")

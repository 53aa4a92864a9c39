"""OBJ and MTL: options, several libraries and materials, and what must not be lost in silence."""

from __future__ import annotations

import numpy as np
import pytest
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
    with pytest.raises(AssetError, match=r"gone\.png, which is not at .*gone\.png"):
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

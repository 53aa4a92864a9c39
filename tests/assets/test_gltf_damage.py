"""Damaged and hostile glTF files: refused by name, before memory is taken or native code is called."""

from __future__ import annotations

import json

import numpy as np
import pytest
from gltf_writer import QUAD, QUAD_FACES, Gltf, textured_quad

from genmf_mi.assets import asset
from genmf_mi.core.errors import AssetError

FOUR = (np.array([[[1, 0, 0], [0, 1, 0]], [[0, 0, 1], [1, 1, 1]]]) * 255).astype(np.uint8)
UNIT_UV = QUAD[:, :2] * [1, -1] + [0, 1]


class TestDamage:
    """Native code is never given what it cannot take, and no memory is taken for what is not there."""

    def quad(self) -> tuple[Gltf, int]:
        gltf = Gltf()
        position = gltf.accessor(QUAD)
        gltf.mesh({"attributes": {"POSITION": position}, "indices": gltf.accessor(QUAD_FACES)})
        return gltf, position

    @pytest.mark.parametrize(
        ("where", "key", "value"),
        [
            ("bufferViews", "byteStride", 2**62),
            ("bufferViews", "byteStride", -12),
            ("bufferViews", "byteOffset", -4),
            ("bufferViews", "byteLength", 2**40),
            ("bufferViews", "byteLength", "twelve"),
            ("accessors", "byteOffset", 2**40),
            ("accessors", "byteOffset", 8),
            ("accessors", "count", 10**12),
            ("accessors", "count", 5),
            ("accessors", "count", -1),
        ],
    )
    def test_numbers_that_cannot_be(self, tmp_path, where, key, value):
        gltf, position = self.quad()
        gltf.tree[where][position][key] = value
        with pytest.raises(AssetError, match=r"damaged|truncated"):
            asset.load(gltf.glb(tmp_path / "a.glb"))

    def test_a_huge_count_without_data(self, tmp_path):
        gltf, position = self.quad()
        del gltf.tree["accessors"][position]["bufferView"]
        gltf.tree["accessors"][position]["count"] = 4 * 10**9
        with pytest.raises(AssetError, match="damaged"):
            asset.load(gltf.glb(tmp_path / "a.glb"))

    @pytest.mark.parametrize("node", [{"scale": [1e30] * 3}, {"translation": [1e30, 0, 0]}, {"scale": [1e200] * 3}])
    def test_nodes_that_blow_it_up(self, tmp_path, node):
        gltf, _ = self.quad()
        gltf.tree["nodes"][0] |= node
        with pytest.raises(AssetError, match=r"coordinates of|not numbers"):
            asset.load(gltf.glb(tmp_path / "a.glb"))

    def test_factors_and_texture_coordinates_that_are_not_numbers(self, tmp_path):
        gltf, _ = self.quad()
        gltf.tree["materials"] = [{"pbrMetallicRoughness": {"baseColorFactor": [float("nan"), 1, 1, 1]}}]
        gltf.tree["meshes"][0]["primitives"][0]["material"] = 0
        with pytest.raises(AssetError, match="base colour that is no number"):
            asset.load(gltf.glb(tmp_path / "a.glb"))
        uv = UNIT_UV.copy()
        uv[1, 0] = np.nan
        with pytest.raises(AssetError, match="texture coordinates that are not numbers"):
            asset.load(textured_quad(tmp_path / "b.glb", FOUR, uv))

    @pytest.mark.parametrize("number", [-1e300, 1.5, 1e300])
    def test_factors_beyond_what_the_format_allows(self, tmp_path, number):
        gltf, _ = self.quad()
        gltf.tree["materials"] = [{"pbrMetallicRoughness": {"baseColorFactor": [number, 0.5, 0.5, 1]}}]
        gltf.tree["meshes"][0]["primitives"][0]["material"] = 0
        found = asset.load(gltf.glb(tmp_path / "a.glb"))
        expected = [float(number > 0), 0.5, 0.5]
        np.testing.assert_allclose(found.closest_albedo(found.vertices[:1]), [expected], atol=1e-6)

    def test_texture_coordinates_beyond_all_textures(self, tmp_path):
        uv = UNIT_UV.copy()
        uv[1, 0] = 1e30
        with pytest.raises(AssetError, match=r"texture coordinates of 1e\+30"):
            asset.load(textured_quad(tmp_path / "a.glb", FOUR, uv))

    @pytest.mark.parametrize("number", [np.nan, np.inf])
    def test_vertex_colours_that_are_not_numbers(self, tmp_path, number):
        gltf, _ = self.quad()
        colours = np.full((4, 3), 0.5, np.float32)
        colours[2, 1] = number
        gltf.tree["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"] = gltf.accessor(colours)
        with pytest.raises(AssetError, match="colours that are not numbers"):
            asset.load(gltf.glb(tmp_path / "a.glb"))

    @pytest.mark.parametrize("uri", ["/etc/passwd", "../outside.bin", "/dev/zero"])
    def test_files_elsewhere_are_refused(self, tmp_path, uri):
        (tmp_path / "outside.bin").write_bytes(b"0" * 100)
        (tmp_path / "home").mkdir()
        gltf, _ = self.quad()
        gltf.tree["buffers"] = [{"uri": uri, "byteLength": len(gltf.binary)}]
        (tmp_path / "home" / "a.gltf").write_text(json.dumps(gltf.tree))
        with pytest.raises(AssetError, match="not below its own folder"):
            asset.load(tmp_path / "home" / "a.gltf")

"""What is seen of an asset is not always what is nearest: stickers, decals, and materials that are clear in part."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from gltf_writer import QUAD, QUAD_FACES, Gltf
from PIL import Image
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from genmf_mi.assets import asset
from genmf_mi.assets.overlays import split


def globe(radius: float, image: Image.Image, **material) -> trimesh.Trimesh:
    """A ball with the picture around it: longitude 0 in the middle, north above."""
    ball = trimesh.creation.icosphere(4, radius=radius)
    x, y, z = ball.vertices.T / radius
    uv = np.stack([np.arctan2(x, z) / (2 * np.pi) + 0.5, np.arcsin(np.clip(y, -1, 1)) / np.pi + 0.5], axis=1)
    ball.visual = TextureVisuals(uv=uv, material=PBRMaterial(baseColorTexture=image, **material))
    return ball


def sticker(alpha: int = 255) -> Image.Image:
    """Clear but for a green square around longitude 0 on the equator; what is clear is black underneath."""
    pixels = np.zeros((64, 128, 4), np.uint8)
    pixels[22:42, 54:74] = (20, 220, 20, alpha)
    return Image.fromarray(pixels)


PLAIN = Image.new("RGB", (2, 2), (250, 250, 250))
FRONT, BACK = np.array([[0.0, 0, 1.003]]), np.array([[0.0, 0, -1.003]])


def colours(scene: list[trimesh.Trimesh], path, points: np.ndarray) -> np.ndarray:
    trimesh.Scene(scene).export(path)
    found = asset.load(path)
    return found.closest_albedo(points, points / np.linalg.norm(points, axis=1, keepdims=True))


class TestStickerSheet:
    @pytest.mark.parametrize("mode", [{"alphaMode": "MASK", "alphaCutoff": 0.5}, {"alphaMode": "BLEND"}])
    def test_only_what_is_printed_on_it_shows(self, tmp_path, mode):
        scene = [globe(1.0, PLAIN), globe(1.003, sticker(), **mode)]
        front, back = colours(scene, tmp_path / "a.glb", np.concatenate([FRONT, BACK]))
        assert front[1] > 0.6 and front[0] < 0.05
        assert back.min() > 0.9

    def test_faint_print_does_not_count(self, tmp_path):
        scene = [globe(1.0, PLAIN), globe(1.003, sticker(100), alphaMode="MASK", alphaCutoff=0.5)]
        assert colours(scene, tmp_path / "a.glb", FRONT).min() > 0.9

    def test_opaque_materials_keep_what_is_under_their_alpha(self, tmp_path):
        """Alpha of OPAQUE is to be ignored, and what is nearest counts as before."""
        front, back = colours([globe(1.0, sticker(), alphaMode="OPAQUE")], tmp_path / "a.glb", np.r_[FRONT, BACK])
        assert front[1] > 0.6 and back.max() < 0.01

    def test_a_model_that_is_opaque_whatever_its_mode_says(self, tmp_path):
        picture = Image.fromarray(np.asarray(sticker())[..., :3])
        trimesh.Scene([globe(1.0, picture, alphaMode="BLEND")]).export(tmp_path / "a.glb")
        found = asset.load(tmp_path / "a.glb")
        body, overlays = split(found.vertices, found.faces, found.albedo)
        assert len(body) == len(found.faces) and not overlays

    def test_where_all_is_transparent_in_part_it_is_the_body(self, tmp_path):
        found = colours([globe(1.0, sticker(), alphaMode="MASK")], tmp_path / "a.glb", FRONT)
        assert found[0, 1] > 0.6


class TestDecal:
    def scene(self, height: float) -> list[trimesh.Trimesh]:
        body = trimesh.creation.box((2, 2, 2))
        body.visual = TextureVisuals(material=PBRMaterial(baseColorFactor=[240, 240, 240, 255]))
        corner = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
        badge = trimesh.Trimesh(
            np.column_stack([corner, np.full(4, 1 + height)]), [[0, 1, 2], [0, 2, 3]], process=False
        )
        picture = Image.fromarray(np.repeat(np.uint8([[255, 0, 0], [0, 0, 255]])[:, None], 2, axis=1))
        badge.visual = TextureVisuals(uv=corner + 0.5, material=PBRMaterial(baseColorTexture=picture))
        return [body, badge]

    @pytest.fixture
    def seen(self, tmp_path):
        def make(height: float, points: list[tuple[float, float, float]], normal=(0.0, 0.0, 1.0)) -> np.ndarray:
            trimesh.Scene(self.scene(height)).export(tmp_path / "a.glb")
            found = asset.load(tmp_path / "a.glb")
            return found.closest_albedo(np.array(points), np.tile(normal, (len(points), 1)))

        return make

    @pytest.mark.parametrize("height", [0.002, 0.01, 0.04])
    def test_covers_what_is_below_it_and_nothing_else(self, seen, height):
        upper, lower, beside, below = seen(height, [(0, 0.3, 1), (0, -0.3, 1), (0.8, 0, 1), (0, 0.3, 1)])
        assert upper[0] > 0.8 and upper[2] < 0.2
        assert lower[2] > 0.8 and lower[0] < 0.2
        assert beside.min() > 0.8
        assert below[0] > 0.8
        assert seen(height, [(0, 0.3, -1)], (0.0, 0.0, -1.0)).min() > 0.8, "the far side"

    def test_is_no_part_of_the_shape(self, tmp_path):
        trimesh.Scene(self.scene(0.01)).export(tmp_path / "a.glb")
        found = asset.load(tmp_path / "a.glb")
        assert len(found.faces) == 14 and len(found.matter) == 12
        trimesh.Scene([globe(1.0, PLAIN), globe(1.003, sticker(), alphaMode="MASK")]).export(tmp_path / "b.glb")
        found = asset.load(tmp_path / "b.glb")
        assert len(found.matter) == len(found.faces), "a closed shell is matter, however transparent"

    def test_what_floats_far_above_is_no_decal(self, seen):
        assert seen(0.2, [(0, 0.3, 1)]).min() > 0.8


def test_a_picture_in_the_emissive_map_is_used(tmp_path):
    gltf = Gltf()
    picture = gltf.image(np.uint8([[[255, 0, 0], [0, 255, 0]]]))
    gltf.tree |= {"textures": [{"source": picture}], "materials": [{
        "pbrMetallicRoughness": {"baseColorFactor": [0, 0, 0, 1]},
        "emissiveTexture": {"index": 0}, "emissiveFactor": [1, 1, 1],
    }]}  # fmt: skip
    uv = gltf.accessor((QUAD[:, :2] * [1, -1] + [0, 1]).astype(np.float32))
    attributes = {"POSITION": gltf.accessor(QUAD), "TEXCOORD_0": uv}
    gltf.mesh({"attributes": attributes, "indices": gltf.accessor(QUAD_FACES), "material": 0})
    found = asset.load(gltf.glb(tmp_path / "a.glb"))
    assert found.textured
    np.testing.assert_allclose(found.closest_albedo(np.array([[0.25, 0.5, 0]])), [[1, 0, 0]], atol=1e-6)

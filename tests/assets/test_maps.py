"""Normal, occlusion and emissive maps of glTF files: which normals, light and colours they make of a point."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from bumpy_ball import height, mapped
from gltf_writer import QUAD, QUAD_FACES, Gltf

from genmf_mi.assets import asset, maps
from genmf_mi.core.colour import to_linear

UP = np.array([0.0, 0.0, 1.0])
UV = (QUAD[:, :2] * [1, -1] + [0, 1]).astype(np.float32)
MIDDLE = np.array([[0.5, 0.5, 0.0]])


def picture(*rgb: int) -> np.ndarray:
    return np.full((4, 4, 3), rgb, np.uint8)


def quad(path, images: list[np.ndarray], material: dict, **attributes: np.ndarray) -> asset.Asset:
    """A unit square with these images as textures in their order."""
    gltf = Gltf()
    named = {"POSITION": gltf.accessor(QUAD), "TEXCOORD_0": gltf.accessor(UV)}
    named |= {name: gltf.accessor(values) for name, values in attributes.items()}
    sources = [gltf.image(pixels) for pixels in images]
    gltf.tree |= {"textures": [{"source": each} for each in sources], "materials": [material]}
    gltf.mesh({"attributes": named, "indices": gltf.accessor(QUAD_FACES), "material": 0})
    return asset.load(gltf.glb(path))


def look(found: asset.Asset, points: np.ndarray = MIDDLE) -> maps.Look:
    seen = found.look(points, np.tile(UP, (len(points), 1)))
    assert seen is not None
    return seen


def bumpy_normals(points: np.ndarray) -> np.ndarray:
    """Of the ball with real bumps at points ``[N,3]`` of the unit sphere, by finite differences of its radius."""
    step, normals = 1e-5, points.copy()
    for row, point in enumerate(points):
        around = np.array([np.cross(point, axis) for axis in np.eye(3)])
        slopes = []
        for direction in around:
            ends = [point + sign * step * direction for sign in (1, -1)]
            radii = []
            for end in ends:
                x, y, z = end / np.linalg.norm(end)
                radii.append(height(np.arccos(y), np.arctan2(x, z)))
            slopes.append((radii[0] - radii[1]) / (2 * step))
        # The gradient on the sphere from its components along the three great circles about the axes
        gradient = np.linalg.lstsq(around, np.array(slopes), rcond=None)[0]
        x, y, z = point
        normals[row] = point - gradient / (1 + height(np.arccos(y), np.arctan2(x, z)))
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("given_tangents", [False, True])
class TestBumpyBall:
    def normals(self, path, points, **how) -> np.ndarray:
        found = asset.load(mapped(path, **how))
        assert found.textured
        seen = found.look(points, points)
        assert seen is not None and (seen.occlusion == 1).all() and not seen.emission.any()
        return seen.normals

    def test_pretends_the_normals_of_real_bumps(self, tmp_path, mirrored, given_tangents):
        rng = np.random.default_rng(0)
        points = rng.normal(size=(300, 3))
        points /= np.linalg.norm(points, axis=1, keepdims=True)
        points = points[np.abs(points[:, 1]) < 0.9]
        ours = self.normals(tmp_path / "a.glb", points, mirrored=mirrored, given_tangents=given_tangents)
        oracle = bumpy_normals(points)
        assert np.degrees(np.arccos((oracle * points).sum(axis=1))).max() > 6
        np.testing.assert_allclose(np.linalg.norm(ours, axis=1), 1)
        assert np.degrees(np.arccos(np.clip((ours * oracle).sum(axis=1), -1, 1))).max() < 1.0

    def test_under_a_node_that_turns_and_mirrors(self, tmp_path, mirrored, given_tangents):
        """Normals turn with the node, and what was raised stays raised."""
        node = {"rotation": [0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)], "scale": [1, 1, -1]}
        moved = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]) @ np.diag([1.0, 1, -1])
        points = np.array([[0.3, 0.2, 0.9], [0.8, -0.3, 0.4], [-0.5, 0.4, -0.7]])
        points /= np.linalg.norm(points, axis=1, keepdims=True)
        how = {"mirrored": mirrored, "given_tangents": given_tangents}
        ours = self.normals(tmp_path / "a.glb", points @ moved.T, node=node, **how)
        np.testing.assert_allclose(ours, self.normals(tmp_path / "b.glb", points, **how) @ moved.T, atol=0.01)


class TestNormalMap:
    def test_green_is_up_and_red_is_right(self, tmp_path):
        for rgb, expected in (((255, 128, 128), (1, 0, 0)), ((128, 255, 128), (0, 1, 0))):
            found = quad(tmp_path / "a.glb", [picture(*rgb)], {"normalTexture": {"index": 0}})
            np.testing.assert_allclose(look(found).normals, [expected], atol=0.02)

    def test_scale_multiplies_the_slope(self, tmp_path):
        images, slope = [picture(178, 128, 245)], (178 / 127.5 - 1) / (245 / 127.5 - 1)
        for scale in (0.5, 1.0, 2.0):
            found = quad(tmp_path / "a.glb", images, {"normalTexture": {"index": 0, "scale": scale}})
            x, y, z = look(found).normals[0]
            assert x / z == pytest.approx(scale * slope) and y == pytest.approx(0)

    def test_a_flat_one_is_none(self, tmp_path):
        for byte in (127, 128):
            found = quad(tmp_path / "a.glb", [picture(byte, byte, 255)], {"normalTexture": {"index": 0}})
            assert not found.textured and found.look(MIDDLE, UP[None]) is None

    def test_grain_finer_than_the_points_is_averaged(self, tmp_path):
        """A checkerboard of texels that lean left and right is flat from afar."""
        board = np.where(np.indices((64, 64)).sum(axis=0)[..., None] % 2, (228, 128, 200), (28, 128, 200))
        found = quad(tmp_path / "a.glb", [board.astype(np.uint8)], {"normalTexture": {"index": 0}})
        at_texel = np.array([[(10 + 0.5) / 64, (20 + 0.5) / 64, 0.0]])
        near = found.look(at_texel, UP[None])
        far = found.look(at_texel, UP[None], spacing=4 / 64)
        assert near is not None and far is not None
        assert abs(near.normals[0, 0]) > 0.6 and abs(far.normals[0, 0]) < 0.02

    def test_second_uv_set(self, tmp_path):
        halves = picture(128, 128, 255)
        halves[:, 2:] = (255, 128, 128)
        material = {"normalTexture": {"index": 0, "texCoord": 1}}
        found = quad(tmp_path / "a.glb", [halves], material, TEXCOORD_1=(UV * [-1, 1] + [1, 0]).astype(np.float32))
        left, right = look(found, np.array([[0.25, 0.5, 0.0], [0.75, 0.5, 0.0]])).normals
        # Mirrored: the right half of the picture lies on the left, and its right is the left of the square
        np.testing.assert_allclose(left, (-1, 0, 0), atol=0.02)
        np.testing.assert_allclose(right, (0, 0, 1), atol=0.02)

    @pytest.mark.parametrize(
        "texture",
        [
            {"index": 0, "texCoord": 3}, {"index": 7}, {"index": 1}, {}, {"index": "0"}, 5,
            {"index": 0, "extensions": {"KHR_texture_transform": {"scale": [1e30, 1]}}},
        ],
    )  # fmt: skip
    def test_one_that_cannot_be_used_is_left_out_and_said(self, tmp_path, texture):
        gltf = Gltf()
        broken = {"bufferView": gltf.view(b"no picture"), "mimeType": "image/png"}
        attributes = {"POSITION": gltf.accessor(QUAD), "TEXCOORD_0": gltf.accessor(UV)}
        red, _ = gltf.image(picture(255, 0, 0)), gltf.tree["images"].append(broken)
        gltf.tree |= {"textures": [{"source": red}, {"source": 1}], "materials": [
            {"name": "m", "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}, "normalTexture": texture}
        ]}  # fmt: skip
        gltf.mesh({"attributes": attributes, "indices": gltf.accessor(QUAD_FACES), "material": 0})
        found = asset.load(gltf.glb(tmp_path / "a.glb"))
        np.testing.assert_allclose(found.closest_albedo(MIDDLE), [[1, 0, 0]], atol=1e-6)
        assert not found.maps
        (note,) = found.notes
        assert "normalTexture" in note and "'m'" in note


class TestOcclusion:
    def test_is_the_red_of_a_picture_that_roughness_shares(self, tmp_path):
        packed = picture(51, 200, 90)
        material = {
            "pbrMetallicRoughness": {"metallicRoughnessTexture": {"index": 0}},
            "occlusionTexture": {"index": 0, "strength": 0.5},
        }
        seen = look(quad(tmp_path / "a.glb", [packed], material))
        assert seen.occlusion[0] == pytest.approx(1 + 0.5 * (51 / 255 - 1))
        np.testing.assert_allclose(seen.normals, [UP])
        white = np.ones((1, 3), np.float32)
        np.testing.assert_allclose(seen.colour(white), 1 - maps.AMBIENT * 0.4, rtol=1e-6)

    def test_red_alone_occludes_nothing(self, tmp_path):
        material = {"pbrMetallicRoughness": {"metallicRoughnessTexture": {"index": 0}}}
        assert not quad(tmp_path / "a.glb", [picture(51, 200, 90)], material).maps


BASE = {"baseColorTexture": {"index": 0}}


class TestEmission:
    def test_adds_to_the_base_colour_and_is_clipped(self, tmp_path):
        material = {
            "pbrMetallicRoughness": BASE,
            "emissiveTexture": {"index": 1}, "emissiveFactor": [0.5, 1, 0],
            "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 2.0}},
        }  # fmt: skip
        found = quad(tmp_path / "a.glb", [picture(100, 100, 100), picture(60, 255, 255)], material)
        seen, base = look(found), found.closest_albedo(MIDDLE)
        base_value, glow = to_linear(np.array([100, 60]) / 255)
        np.testing.assert_allclose(base, base_value, rtol=1e-5)
        np.testing.assert_allclose(seen.emission, [[glow, 2.0, 0.0]], rtol=1e-5)
        np.testing.assert_allclose(seen.colour(base), [[base_value + glow, 1.0, base_value]], rtol=1e-5)

    def test_one_picture_that_is_both_is_meant_once(self, tmp_path):
        material = {
            "pbrMetallicRoughness": BASE, "emissiveTexture": {"index": 0}, "emissiveFactor": [1, 1, 1],
        }  # fmt: skip
        assert not quad(tmp_path / "a.glb", [picture(100, 60, 10)], material).maps

    def test_no_factor_no_light(self, tmp_path):
        material = {"pbrMetallicRoughness": BASE, "emissiveTexture": {"index": 1}}
        assert not quad(tmp_path / "a.glb", [picture(100, 60, 10), picture(255, 0, 0)], material).maps

    def test_lamps_on_a_body_of_one_colour(self, tmp_path):
        """A picture that is mostly black adds to the body, one of the whole object is its texture."""
        lamps = np.zeros((8, 8, 3), np.uint8)
        lamps[:2, :2] = 255
        material = {
            "pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.5, 0.5, 1]},
            "emissiveTexture": {"index": 0}, "emissiveFactor": [1, 0, 0],
        }  # fmt: skip
        found = quad(tmp_path / "a.glb", [lamps], material)
        dark, bright = look(found, np.array([[0.8, 0.2, 0], [0.1, 0.9, 0]])).emission
        np.testing.assert_allclose(found.closest_albedo(MIDDLE), 0.5)
        assert not dark.any()
        np.testing.assert_allclose(bright, [1, 0, 0], atol=1e-6)
        whole = quad(tmp_path / "b.glb", [255 - lamps], material)
        assert not whole.maps
        np.testing.assert_allclose(whole.closest_albedo(MIDDLE), [[1, 0, 0]], atol=1e-6)


def test_maps_can_be_left_out(tmp_path):
    found = asset.load(mapped(tmp_path / "a.glb"))
    assert found.with_maps(normal=True, occlusion=False, emission=False).maps
    without = found.with_maps(normal=False, occlusion=True, emission=True)
    assert not without.maps and not without.textured


def test_tangents_are_averaged_around_a_vertex_and_not_across_a_mirrored_seam():
    """As MikkTSpace does: on a ball, they follow the circles of latitude to within the interpolation."""
    ball = trimesh.creation.icosphere(4)
    uv = np.stack([ball.vertices[:, 0], 1 - ball.vertices[:, 1]], axis=1)
    front = ball.faces[ball.triangles_center[:, 2] > 0.3]
    right, up = maps.tangents(np.array(ball.vertices), front, uv)
    assert right.shape == up.shape == (len(front), 3, 3)
    inside = np.einsum("fkc,fkc->fk", right, np.array(ball.vertices)[front])
    assert np.abs(inside).max() < 0.12
    fold = np.array([[0, 1, 2], [1, 3, 2]])
    flat = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    for last, same in (((1, 0), True), ((0, 1), False)):  # of the fourth corner: beyond the edge, or folded back
        right, up = maps.tangents(flat, fold, np.array([[0.0, 1], [1, 1], [0, 0], last]))
        np.testing.assert_allclose(right[0, 1], [1, 0, 0], atol=1e-12)
        np.testing.assert_allclose(up[0, 1], [0, 1, 0], atol=1e-12)
        assert np.allclose(right[0, 1], right[1, 0]) == same

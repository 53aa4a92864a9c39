"""glTF files written by hand: everything that a general reader drops without a word."""

from __future__ import annotations

import base64
import json
import sys

import numpy as np
import pytest
import trimesh
from gltf_writer import QUAD, QUAD_FACES, Gltf, textured_quad

from genmf_mi.assets import asset
from genmf_mi.core.colour import to_linear
from genmf_mi.core.errors import AssetError

RED, GREEN, BLUE, WHITE = [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]
FOUR = (np.array([[RED, GREEN], [BLUE, WHITE]]) * 255).astype(np.uint8)
"""Red and green above, blue and white below."""
UNIT_UV = QUAD[:, :2] * [1, -1] + [0, 1]
"""The square shows the picture upright: v = 0 is at the top."""
CENTRES = {"red": (0.25, 0.75), "green": (0.75, 0.75), "blue": (0.25, 0.25), "white": (0.75, 0.25)}


def at(found: asset.Asset, x: float, y: float) -> np.ndarray:
    """The colour of the unit square at (x, y)."""
    return found.closest_albedo(np.array([[x, y, 0.0]]))[0]


def test_picture_stands_upright(tmp_path):
    found = asset.load(textured_quad(tmp_path / "quad.glb", FOUR, UNIT_UV, sampler={"magFilter": 9728}))
    assert found.textured
    for name, colour in (("red", RED), ("green", GREEN), ("blue", BLUE), ("white", WHITE)):
        np.testing.assert_allclose(at(found, *CENTRES[name]), colour, atol=1e-6, err_msg=name)


@pytest.mark.parametrize(
    ("code", "expected"), [(10497, [RED, RED]), (33071, [GREEN, GREEN]), (33648, [GREEN, RED])], ids=str
)
def test_wrap_modes(tmp_path, code, expected):
    # u runs from 0 to 3 over the square: its second third repeats the picture, mirrors it or holds its last column.
    sampler = {"magFilter": 9728, "wrapS": code, "wrapT": 33071}
    found = asset.load(textured_quad(tmp_path / "quad.glb", FOUR, UNIT_UV * [3, 1], sampler=sampler))
    np.testing.assert_allclose(at(found, 1.25 / 3, 0.75), expected[0], atol=1e-6)
    np.testing.assert_allclose(at(found, 1.75 / 3, 0.75), GREEN if code != 33648 else RED, atol=1e-6)


def test_texture_transform_moves_turns_and_scales(tmp_path):
    nearest = {"magFilter": 9728, "wrapS": 33071, "wrapT": 33071}
    moved = {"offset": [0.5, 0.0], "scale": [0.5, 1.0]}
    found = asset.load(textured_quad(tmp_path / "a.glb", FOUR, UNIT_UV, sampler=nearest, transform=moved))
    np.testing.assert_allclose(at(found, 0.1, 0.9), GREEN, atol=1e-6)
    np.testing.assert_allclose(at(found, 0.9, 0.1), WHITE, atol=1e-6)
    # A quarter turn counter-clockwise in the picture takes u to -v; the offset brings it back.
    turned = {"rotation": np.pi / 2, "offset": [0.0, 1.0]}
    found = asset.load(textured_quad(tmp_path / "b.glb", FOUR, UNIT_UV, sampler=nearest, transform=turned))
    # The corner with uv (0, 0) reads (0, 1): blue; uv (1, 0) reads (0, 0): red.
    np.testing.assert_allclose(at(found, 0.1, 0.9), BLUE, atol=1e-6)
    np.testing.assert_allclose(at(found, 0.9, 0.9), RED, atol=1e-6)


def test_second_uv_set(tmp_path):
    path = textured_quad(tmp_path / "quad.glb", FOUR, UNIT_UV, sampler={"magFilter": 9728}, uv_set=1)
    np.testing.assert_allclose(at(asset.load(path), *CENTRES["green"]), GREEN, atol=1e-6)


@pytest.mark.parametrize("kind", ["f4", "u1", "u2"])
def test_texture_factor_and_vertex_colours_multiply(tmp_path, kind):
    shade = np.array([[0.2, 0.4, 0.6, 1.0]] * 4)
    stored = shade.astype("<f4") if kind == "f4" else np.rint(shade * np.iinfo(kind).max).astype(f"<{kind}")
    grey = np.full((2, 2, 3), 128, dtype=np.uint8)
    path = textured_quad(tmp_path / "quad.glb", grey, UNIT_UV, factor=[0.5, 1.0, 1.0, 1.0], colours=stored)
    expected = to_linear(128 / 255) * np.array([0.5 * 0.2, 0.4, 0.6])
    np.testing.assert_allclose(at(asset.load(path), 0.5, 0.4), expected, rtol=2e-3 if kind == "u1" else 1e-4)


def test_vertex_colours_and_factors_are_linear(tmp_path):
    gltf = Gltf()
    attributes = {
        "POSITION": gltf.accessor(QUAD),
        "COLOR_0": gltf.accessor(np.full((4, 3), 0.5, dtype=np.float32)),
    }
    gltf.tree["materials"] = [{"pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.5, 0.5, 1]}}]
    gltf.mesh({"attributes": attributes, "indices": gltf.accessor(QUAD_FACES), "material": 0})
    path = gltf.glb(tmp_path / "a.glb")
    np.testing.assert_allclose(at(asset.load(path), 0.3, 0.3), 0.25, atol=1e-6)


def test_several_materials_meshes_and_instances(tmp_path):
    gltf = Gltf()
    position, indices = gltf.accessor(QUAD), gltf.accessor(QUAD_FACES)
    gltf.tree["materials"] = [{"pbrMetallicRoughness": {"baseColorFactor": [*colour, 1]}} for colour in (RED, GREEN)]
    primitives = [{"attributes": {"POSITION": position}, "indices": indices, "material": index} for index in (0, 1)]
    gltf.mesh(
        *primitives,
        nodes=[{"children": [1, 2]}, {"mesh": 0}, {"mesh": 1, "translation": [5, 0, 0]}],
    )
    gltf.tree["meshes"] = [{"primitives": [primitives[0]]}, {"primitives": primitives}]
    found = asset.load(gltf.glb(tmp_path / "a.glb"))
    assert len(found.faces) == 6
    assert found.textured
    np.testing.assert_allclose(found.vertices.max(axis=0), [6, 1, 0])
    np.testing.assert_allclose(at(found, 0.5, 0.5), RED)
    colours = found.albedo_at(np.arange(6), np.full((6, 3), 1 / 3))
    np.testing.assert_allclose(colours, [RED, RED, RED, RED, GREEN, GREEN])


def random_scene(seed: int) -> Gltf:
    """A closed box under a chain of nodes with random translations, rotations and scales, some of them mirroring."""
    rng = np.random.default_rng(seed)
    box = trimesh.creation.box()
    gltf = Gltf()
    attributes = {"POSITION": gltf.accessor(box.vertices.astype(np.float32))}
    indices = gltf.accessor(box.faces.astype(np.uint32).ravel())
    nodes = []
    for index in range(3):
        turn = rng.normal(size=4)
        nodes.append(
            {
                "translation": rng.normal(size=3).tolist(),
                "rotation": (turn / np.linalg.norm(turn)).tolist(),
                "scale": (rng.uniform(0.5, 2, 3) * rng.choice([-1, 1], 3)).tolist(),
                **({"children": [index + 1]} if index < 2 else {"mesh": 0}),
            }
        )
    matrix = np.eye(4)
    matrix[:3] = rng.normal(size=(3, 4))
    nodes[1] = {"matrix": matrix.T.ravel().tolist(), "children": [2]}
    return gltf.mesh({"attributes": attributes, "indices": indices}, nodes=nodes)


@pytest.mark.parametrize("seed", range(6))
def test_node_transforms_agree_with_trimesh_and_keep_faces_outwards(tmp_path, seed):
    path = random_scene(seed).glb(tmp_path / "scene.glb")
    found = asset.load(path)
    other = trimesh.load_scene(path).to_mesh()
    order = np.lexsort(np.round(other.vertices, 4).T), np.lexsort(np.round(found.vertices, 4).T)
    np.testing.assert_allclose(found.vertices[order[1]], other.vertices[order[0]], atol=1e-5)
    assert trimesh.Trimesh(found.vertices, found.faces, process=False).volume > 0


def test_strips_fans_and_missing_indices(tmp_path):
    gltf = Gltf()
    zigzag = gltf.accessor(QUAD[[0, 1, 3, 2]])
    around = gltf.accessor(QUAD)
    soup = gltf.accessor(QUAD[QUAD_FACES])
    gltf.mesh(
        {"attributes": {"POSITION": zigzag}, "mode": 5},
        {"attributes": {"POSITION": around}, "mode": 6},
        {"attributes": {"POSITION": soup}},
        {"attributes": {"POSITION": soup}, "mode": 1},
    )
    found = asset.load(gltf.glb(tmp_path / "a.glb"))
    corner = found.vertices[found.faces]
    areas = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])[:, 2] / 2
    np.testing.assert_allclose(areas, 0.5)  # six triangles, all counter-clockwise; the lines are left out


def test_interleaved_sparse_and_quantised_accessors(tmp_path):
    gltf = Gltf()
    rows = np.zeros(4, dtype=[("position", "<f4", 3), ("uv", "<u2", 2)])
    rows["position"], rows["uv"] = QUAD, np.rint(UNIT_UV * 65535)
    view = gltf.view(rows.tobytes(), byteStride=rows.dtype.itemsize)
    gltf.tree["accessors"] += [
        {"bufferView": view, "componentType": 5126, "count": 4, "type": "VEC3"},
        {
            "bufferView": view, "byteOffset": 12, "componentType": 5123, "count": 4, "type": "VEC2",
            "normalized": True,
        },
    ]  # fmt: skip
    where = gltf.view(np.array([2], dtype="<u2").tobytes())
    what = gltf.view(np.array([[3, 4, 5]], dtype="<f4").tobytes())
    gltf.tree["accessors"][0]["sparse"] = {
        "count": 1,
        "indices": {"bufferView": where, "componentType": 5123},
        "values": {"bufferView": what},
    }
    gltf.tree |= {
        "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
        "textures": [{"source": gltf.image(FOUR)}],
        "extensionsRequired": ["KHR_mesh_quantization"],
    }
    attributes = {"POSITION": 0, "TEXCOORD_0": 1}
    gltf.mesh({"attributes": attributes, "indices": gltf.accessor(QUAD_FACES), "material": 0})
    found = asset.load(gltf.glb(tmp_path / "a.glb"))
    np.testing.assert_allclose(found.vertices, [[0, 0, 0], [1, 0, 0], [3, 4, 5], [0, 1, 0]])
    np.testing.assert_allclose(found.albedo.uv, UNIT_UV, atol=1e-5)


def test_skins_and_morph_targets_give_the_pose_of_the_file(tmp_path):
    gltf = Gltf()
    moved = np.zeros((4, 3), np.float32)
    moved[2] = [0, 0, 4]
    attributes = {
        "POSITION": gltf.accessor(QUAD),
        "JOINTS_0": gltf.accessor(np.array([[0, 1, 0, 0]] * 4, dtype=np.uint8)),
        "WEIGHTS_0": gltf.accessor(np.array([[1, 0, 0, 0], [1, 0, 0, 0], [0, 1, 0, 0], [0.5, 0.5, 0, 0]], "<f4")),
    }
    inverse = np.stack([np.eye(4), np.eye(4)])
    inverse[1, :3, 3] = [0, 0, -1]
    nodes = [
        {"children": [1, 2, 3]},
        {"mesh": 0, "skin": 0, "translation": [100, 0, 0]},  # does not apply to a skinned mesh
        {"translation": [1, 0, 0]},
        {"translation": [0, 2, 0], "scale": [2, 2, 2]},
    ]
    gltf.mesh(
        {
            "attributes": attributes,
            "indices": gltf.accessor(QUAD_FACES),
            "targets": [{"POSITION": gltf.accessor(moved)}],
        },
        nodes=nodes,
    )
    gltf.tree["meshes"][0]["weights"] = [0.5]
    matrices = gltf.accessor(inverse.transpose(0, 2, 1).astype("<f4"))
    gltf.tree["skins"] = [{"joints": [2, 3], "inverseBindMatrices": matrices}]
    found = asset.load(gltf.glb(tmp_path / "a.glb"))
    rest = QUAD + 0.5 * moved
    first, second = rest + np.array([1, 0, 0]), 2 * (rest - np.array([0, 0, 1])) + np.array([0, 2, 0])
    expected = [first[0], first[1], second[2], (first[3] + second[3]) / 2]
    np.testing.assert_allclose(found.vertices, expected, atol=1e-6)


def test_json_file_with_external_and_embedded_resources(tmp_path):
    path = textured_quad(tmp_path / "quad.glb", FOUR, UNIT_UV, sampler={"magFilter": 9728})
    data = path.read_bytes()
    size = int.from_bytes(data[12:16], "little")
    tree, binary = json.loads(data[20 : 20 + size]), data[28 + size :]
    (tmp_path / "the buffer.bin").write_bytes(binary)
    tree["buffers"][0]["uri"] = "the%20buffer.bin"
    view = tree["bufferViews"][tree["images"][0].pop("bufferView")]
    png = binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
    tree["images"][0]["uri"] = "data:image/png;base64," + base64.b64encode(png).decode()
    (tmp_path / "quad.gltf").write_text(json.dumps(tree))
    np.testing.assert_allclose(at(asset.load(tmp_path / "quad.gltf"), *CENTRES["blue"]), BLUE, atol=1e-6)

    tree["images"][0]["uri"] = "gone.png"
    (tmp_path / "quad.gltf").write_text(json.dumps(tree))
    with pytest.raises(AssetError, match=r"gone\.png, which is not beside it"):
        asset.load(tmp_path / "quad.gltf")


def test_every_truncation_is_refused(tmp_path):
    data = textured_quad(tmp_path / "whole.glb", FOUR, UNIT_UV).read_bytes()
    path = tmp_path / "part.glb"
    for length in (1, 4, 12, 19, 40, len(data) // 2, len(data) - 1):
        path.write_bytes(data[:length])
        with pytest.raises(AssetError, match=r"part\.glb"):
            asset.load(path)


def test_what_is_not_understood_is_named(tmp_path):
    gltf = Gltf()
    gltf.tree["extensionsRequired"] = ["EXT_meshopt_compression"]
    gltf.mesh({"attributes": {"POSITION": gltf.accessor(QUAD)}, "indices": gltf.accessor(QUAD_FACES)})
    with pytest.raises(AssetError, match="EXT_meshopt_compression"):
        asset.load(gltf.glb(tmp_path / "a.glb"))


def test_faces_that_point_nowhere_are_refused(tmp_path):
    gltf = Gltf()
    indices = gltf.accessor(np.array([0, 1, 9], dtype=np.uint16))
    gltf.mesh({"attributes": {"POSITION": gltf.accessor(QUAD)}, "indices": indices})
    with pytest.raises(AssetError, match="missing vertices"):
        asset.load(gltf.glb(tmp_path / "a.glb"))


def test_draco_compression(tmp_path):
    pytest.importorskip("DracoPy", reason="DracoPy is not installed; it comes with the extra 'draco'")
    rgb = np.random.default_rng(0).integers(0, 256, (162, 4), dtype=np.uint8)
    ball = trimesh.creation.icosphere(subdivisions=2)
    ball.visual.vertex_colors = rgb
    (tmp_path / "a.glb").write_bytes(ball.export(file_type="glb", extension_draco=True))
    assert b"KHR_draco_mesh_compression" in (tmp_path / "a.glb").read_bytes()
    found = asset.load(tmp_path / "a.glb")
    np.testing.assert_allclose(found.vertices[found.faces].mean(axis=(0, 1)), 0, atol=1e-3)
    assert trimesh.Trimesh(found.vertices, found.faces).volume == pytest.approx(ball.volume, rel=1e-3)
    np.testing.assert_allclose(found.closest_albedo(ball.vertices), rgb[:, :3] / 255, atol=0.01)


def test_draco_without_its_library_says_what_to_install(tmp_path, monkeypatch):
    gltf = Gltf()
    primitive = {
        "attributes": {"POSITION": gltf.accessor(QUAD)},
        "indices": gltf.accessor(QUAD_FACES),
        "extensions": {"KHR_draco_mesh_compression": {"bufferView": 0, "attributes": {"POSITION": 0}}},
    }
    monkeypatch.setitem(sys.modules, "DracoPy", None)
    with pytest.raises(AssetError, match="pip install DracoPy"):
        asset.load(gltf.mesh(primitive).glb(tmp_path / "a.glb"))

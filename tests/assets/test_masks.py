"""Masks by texture coordinates, by colours of meshes and by the names that files give to their parts."""

from __future__ import annotations

import json

import lib3mf
import numpy as np
import pytest
import trimesh
from PIL import Image
from toys import sphere

from genmf_mi.assets import masks
from genmf_mi.assets.asset import Asset, load
from genmf_mi.core.errors import ConfigError

UP = np.array([[0.0, 0, 1]])
OBJ = """
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
v 2 0 0
v 2 1 0
vt 0 0
vt 1 1
"""


@pytest.fixture
def square() -> Asset:
    """In z = 0, with u along x and v against y; a grey texture that is shifted by a half along u."""
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    uv = np.stack([vertices[:, 0], 1 - vertices[:, 1]], axis=1)
    texture = np.full((2, 2, 3), 128, np.uint8)
    texture[0, 0] = 0
    return Asset.from_arrays("square", vertices, np.array([[0, 1, 2], [0, 2, 3]]), uv=uv, texture=texture)


def at(mask, *points) -> np.ndarray:
    points = np.array([(*point, 0.0) for point in points])
    return mask(points, np.repeat(UP, len(points), axis=0))


class TestImages:
    def test_white_is_full_relief_and_grey_a_share(self, square, tmp_path):
        pixels = np.zeros((40, 40), np.uint8)
        pixels[:20, :20], pixels[20:, 20:] = 255, 128  # the upper left, and the lower right
        Image.fromarray(pixels).save(tmp_path / "mask.png")
        values = at(masks.of_image(square, tmp_path / "mask.png"), (0.2, 0.8), (0.8, 0.8), (0.2, 0.2), (0.8, 0.2))
        np.testing.assert_allclose(values, [1, 0, 0, 128 / 255], atol=1e-5)

    def test_what_is_not_on_the_map_has_its_relief(self, tmp_path):
        vertices = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
        uv = np.array([[0.2, 0.2], [0.8, 0.2], [0.8, 0.8], [0.2, 0.2]])
        faces = np.array([[0, 1, 2], [0, 2, 3]])
        uv[[3]] = uv[0]
        asset = Asset.from_arrays("half", vertices[[0, 1, 2, 3, 3, 3]], faces, uv=uv[[0, 1, 2, 3, 3, 3]],
                                  texture=np.zeros((2, 2, 3), np.uint8))  # fmt: skip
        Image.new("L", (4, 4), 0).save(tmp_path / "mask.png")
        assert at(masks.of_image(asset, tmp_path / "mask.png"), (0.8, 0.2)) == 0

    def test_refused(self, square, tmp_path):
        (tmp_path / "mask.png").write_text("no image")
        for name in ("mask.png", "gone.png"):
            with pytest.raises(ConfigError, match=f"cannot read the mask .*{name}"):
                masks.of_image(square, tmp_path / name)
        vertices, faces, _ = sphere(1)
        with pytest.raises(ConfigError, match="no texture coordinates"):
            masks.of_image(Asset.from_arrays("ball", vertices, faces), tmp_path / "mask.png")


class TestColours:
    @pytest.mark.parametrize("name", ["mask.ply", "mask.glb"])
    def test_of_a_mesh_in_the_same_pose(self, tmp_path, name):
        vertices, faces, normals = sphere(4)
        colours = np.where(vertices[:, :1] > 0, 255, [[0, 0, 0]]).astype(np.uint8)
        trimesh.Trimesh(vertices, faces, vertex_colors=colours, process=False).export(tmp_path / name)
        mask = masks.of_mesh(tmp_path / name)
        far = np.abs(normals[:, 0]) > 0.1
        np.testing.assert_allclose(mask(vertices, normals)[far], (vertices[:, 0] > 0)[far], atol=1e-6)

    def test_of_the_asset_itself(self):
        vertices, faces, normals = sphere(4)
        grey = np.repeat(np.where(vertices[:, :1] > 0, 1.0, 0.0), 3, axis=1)
        white, mask = masks.of_vertex_colours(Asset.from_arrays("ball", vertices, faces, colours=grey))
        assert (white.closest_albedo(vertices) == 1).all()
        np.testing.assert_allclose(mask(vertices, normals), grey[:, 0], atol=1e-6)

    def test_refused(self, tmp_path):
        vertices, faces, _ = sphere(1)
        with pytest.raises(ConfigError, match="no vertex colours that differ"):
            masks.of_vertex_colours(Asset.from_arrays("ball", vertices, faces))
        trimesh.Trimesh(vertices, faces).export(tmp_path / "plain.ply")
        with pytest.raises(ConfigError, match="one colour all over"):
            masks.of_mesh(tmp_path / "plain.ply")
        with pytest.raises(ConfigError, match=r"cannot read the mask: .*gone\.ply does not exist"):
            masks.of_mesh(tmp_path / "gone.ply")


class TestNames:
    @pytest.fixture
    def obj(self, tmp_path) -> Asset:
        (tmp_path / "a.mtl").write_text("newmtl glass\nKd 1 0 0\nnewmtl paint\nKd 0 1 0\n")
        faces = "o front\nusemtl glass\nf 1 2 3\ng left lid\nusemtl paint\nf 1 3 4\no back side\ng\nf 2 5 6 3\n"
        (tmp_path / "a.obj").write_text("mtllib a.mtl\n" + OBJ + faces)
        return load(tmp_path / "a.obj")

    def test_of_an_obj(self, obj):
        assert [m.name for m in obj.albedo.materials] == ["glass", "paint"]
        assert [obj.groups[k] for k in obj.group] == [
            ("front",), ("front", "left", "lid"), ("back side",), ("back side",)
        ]  # fmt: skip
        places = (0.8, 0.2), (0.2, 0.8), (1.5, 0.5)
        for materials, faces, expected in (
            (["glass"], [], [0, 1, 1]),
            (["paint"], [], [1, 0, 0]),
            ([], ["lid"], [1, 0, 1]),
            ([], ["front"], [0, 0, 1]),
            ([], ["back side"], [1, 1, 0]),
            (["glass"], ["back side"], [0, 1, 0]),
        ):
            np.testing.assert_array_equal(at(masks.of_names(obj, materials, faces), *places), expected)

    def test_unknown_ones_are_refused_with_those_that_there_are(self, obj):
        with pytest.raises(ConfigError, match=r"no material named chrome\. Choose among: glass, paint\."):
            masks.of_names(obj, ["chrome", "paint"], [])
        with pytest.raises(ConfigError, match=r"no object or group named roof\. Choose among: back side, front, left"):
            masks.of_names(obj, [], ["roof"])
        vertices, faces, _ = sphere(1)
        with pytest.raises(ConfigError, match="Its file names no material"):
            masks.of_names(Asset.from_arrays("ball", vertices, faces), ["glass"], [])

    def test_of_a_gltf(self, tmp_path):
        scene = trimesh.Scene()
        for i, name in enumerate(("cup", "saucer")):
            box = trimesh.creation.box().apply_translation((2 * i, 0, 0))
            box.visual = trimesh.visual.TextureVisuals(
                material=trimesh.visual.material.PBRMaterial(name=f"{name} clay", baseColorFactor=(255, 99 * i, 0, 255))
            )
            scene.add_geometry(box, node_name=name, geom_name=f"{name} mesh")
        scene.export(tmp_path / "set.glb")
        asset = load(tmp_path / "set.glb")
        assert {m.name for m in asset.albedo.materials} == {"cup clay", "saucer clay"}
        assert set(asset.groups) == {("cup", "cup mesh"), ("saucer", "saucer mesh")}
        points = np.array([[0, 0, 0.5], [2, 0, 0.5]])
        for names in ((["cup clay"], []), ([], ["cup"]), ([], ["cup mesh"])):
            np.testing.assert_array_equal(masks.of_names(asset, *names)(points, np.repeat(UP, 2, axis=0)), [0, 1])

    def test_of_a_3mf(self, tmp_path):
        model = lib3mf.get_wrapper().CreateModel()
        box = trimesh.creation.box()
        for i, name in enumerate(("hull", "")):
            mesh = model.AddMeshObject()
            mesh.SetName(name)
            shifted = box.vertices + np.array([2.0 * i, 0, 0])
            mesh.SetGeometry([lib3mf.Position(tuple(v)) for v in shifted.tolist()],
                             [lib3mf.Triangle(tuple(f)) for f in box.faces.tolist()])  # fmt: skip
            model.AddBuildItem(mesh, lib3mf.get_wrapper().GetIdentityTransform())
        model.QueryWriter("3mf").WriteToFile(str(tmp_path / "boat.3mf"))
        asset = load(tmp_path / "boat.3mf")
        assert asset.groups == (("hull",), ()) and np.bincount(asset.group).tolist() == [12, 12]


def test_names_survive_a_change_of_axis(tmp_path):
    (tmp_path / "a.obj").write_text(OBJ + "o lid\nf 1 2 3\n")
    assert load(tmp_path / "a.obj", up="z").groups == (("lid",),)
    assert json.dumps(load(tmp_path / "a.obj").groups) == '[["lid"]]'

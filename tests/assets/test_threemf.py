"""3MF files written with lib3mf: colours, materials, textures and assemblies come through."""

from __future__ import annotations

import io
import re
import zipfile

import lib3mf
import numpy as np
import pytest
import trimesh
from PIL import Image

from genmf_mi.assets import asset
from genmf_mi.core.colour import to_linear
from genmf_mi.core.errors import AssetError


class Builder:
    """A model that grows by boxes."""

    def __init__(self) -> None:
        self.wrapper = lib3mf.get_wrapper()
        self.model = self.wrapper.CreateModel()

    def box(self):
        mesh, box = self.model.AddMeshObject(), trimesh.creation.box()
        mesh.SetGeometry(
            [lib3mf.Position(tuple(vertex)) for vertex in box.vertices.tolist()],
            [lib3mf.Triangle(tuple(face)) for face in box.faces.tolist()],
        )
        return mesh

    def paint(self, mesh, group, numbers) -> None:
        """The property numbers ``[12,3]`` of ``group`` on the corners of a box."""
        identifier = group.GetUniqueResourceID()
        mesh.SetAllTriangleProperties([lib3mf.TriangleProperties(identifier, tuple(row)) for row in numbers])
        mesh.SetObjectLevelProperty(identifier, numbers[0][0])

    def place(self, item, offset=(0, 0, 0)) -> None:
        self.model.AddBuildItem(item, self.shift(offset))

    def shift(self, offset):
        transform = self.wrapper.GetIdentityTransform()
        for axis in range(3):
            transform.Fields[3][axis] = offset[axis]
        return transform

    def load(self, path) -> asset.Asset:
        self.model.QueryWriter("3mf").WriteToFile(str(path))
        return asset.load(path)


def middles(found: asset.Asset) -> np.ndarray:
    return found.albedo_at(np.arange(len(found.faces)), np.full((len(found.faces), 3), 1 / 3))


def test_z_up_becomes_y_up_and_assemblies_are_placed(tmp_path):
    builder = Builder()
    assembly = builder.model.AddComponentsObject()
    assembly.AddComponent(builder.box(), builder.shift((0, 0, 10)))
    builder.place(assembly, (1, 2, 3))
    found = builder.load(tmp_path / "a.3mf")
    np.testing.assert_allclose(found.vertices.min(axis=0), [0.5, 12.5, -2.5])
    np.testing.assert_allclose(found.vertices.max(axis=0), [1.5, 13.5, -1.5])
    assert trimesh.Trimesh(found.vertices, found.faces).volume == pytest.approx(1)
    assert not found.textured


def test_colour_groups_materials_and_mixtures(tmp_path):
    builder = Builder()
    colours = builder.model.AddColorGroup()
    red, grey = (colours.AddColor(lib3mf.Color(*rgb, 255)) for rgb in ((255, 0, 0), (128, 128, 128)))
    base = builder.model.AddBaseMaterialGroup()
    white, black = (base.AddMaterial(name, lib3mf.Color(*rgb, 255)) for name, rgb in (("w", [255] * 3), ("b", [0] * 3)))
    mixed = builder.model.AddCompositeMaterials(base)
    half = mixed.AddComposite([lib3mf.CompositeConstituent(white, 0.25), lib3mf.CompositeConstituent(black, 0.75)])
    for group, numbers in (
        (colours, [[red] * 3] * 6 + [[grey, grey, red]] * 6),
        (base, [[white] * 3] * 12),
        (mixed, [[half] * 3] * 12),
    ):
        mesh = builder.box()
        builder.paint(mesh, group, numbers)
        builder.place(mesh)
    found = middles(builder.load(tmp_path / "a.3mf"))
    light = to_linear(128 / 255)
    np.testing.assert_allclose(found[:6], [[1, 0, 0]] * 6)
    np.testing.assert_allclose(found[6:12], [[(1 + 2 * light) / 3, 2 * light / 3, 2 * light / 3]] * 6, rtol=1e-5)
    np.testing.assert_allclose(found[12:24], 1)
    np.testing.assert_allclose(found[24:], 0.25, rtol=1e-6)


def test_textures_stand_upright_and_tile(tmp_path):
    builder = Builder()
    picture = (np.array([[[1, 0, 0], [0, 1, 0]], [[0, 0, 1], [1, 1, 1]]]) * 255).astype(np.uint8)
    stream = io.BytesIO()
    Image.fromarray(picture).save(stream, "PNG")
    attachment = builder.model.AddAttachment(
        "/3D/Texture/four.png", "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dtexture"
    )
    attachment.ReadFromBuffer(list(stream.getvalue()))
    texture = builder.model.AddTexture2DFromAttachment(attachment)
    texture.SetContentType(lib3mf.TextureType.PNG)
    texture.SetTileStyleUV(lib3mf.TextureTileStyle.Clamp, lib3mf.TextureTileStyle.Wrap)
    group = builder.model.AddTexture2DGroup(texture)
    places = [(0.25, 0.75), (0.75, 0.25), (7.0, 0.75), (0.25, 1.25)]
    numbers = [group.AddTex2Coord(lib3mf.Tex2Coord(*uv)) for uv in places]
    mesh = builder.box()
    builder.paint(mesh, group, [[number] * 3 for number in numbers * 3])
    builder.place(mesh)
    found = middles(builder.load(tmp_path / "a.3mf"))
    expected = [[1, 0, 0], [1, 1, 1], [0, 1, 0], [0, 0, 1]]  # v points up; clamped along u, repeated along v
    np.testing.assert_allclose(found, expected * 3, atol=1e-6)


def test_layers_of_colours_are_refused_by_name(tmp_path):
    builder = Builder()
    colours = builder.model.AddColorGroup()
    red = colours.AddColor(lib3mf.Color(255, 0, 0, 255))
    layers = builder.model.AddMultiPropertyGroup()
    layers.AddLayer(lib3mf.MultiPropertyLayer(colours.GetUniqueResourceID(), lib3mf.BlendMethod.Mix.value))
    number = layers.AddMultiProperty([red])
    mesh = builder.box()
    builder.paint(mesh, layers, [[number] * 3] * 12)
    builder.place(mesh)
    with pytest.raises(AssetError, match="multi-properties"):
        builder.load(tmp_path / "a.3mf")


class TestSlicersOwnFiles:
    """What slicers keep in a way of their own is named, and never dropped in silence."""

    @pytest.fixture
    def changed(self, tmp_path):
        """A box whose model file and archive are changed after lib3mf has written them."""

        def make(change, **members: str) -> asset.Asset:
            builder = Builder()
            builder.place(builder.box())
            builder.load(tmp_path / "plain.3mf")
            with zipfile.ZipFile(tmp_path / "plain.3mf") as old, zipfile.ZipFile(tmp_path / "a.3mf", "w") as new:
                for name in old.namelist():
                    content = old.read(name)
                    new.writestr(name, change(content) if name.endswith(".model") else content)
                for name, content in members.items():
                    new.writestr(f"Metadata/{name}.config", content)
            return asset.load(tmp_path / "a.3mf")

        return make

    @pytest.mark.parametrize(
        ("paint", "program"), [(b'paint_color="8"', "Bambu Studio"), (b'slic3rpe:mmu_segmentation="4"', "PrusaSlicer")]
    )
    def test_painted_triangles(self, changed, paint, program):
        prefix = b' xmlns:slic3rpe="http://schemas.slic3r.org/3mf/2017/06"'

        def change(model: bytes) -> bytes:
            return model.replace(b"<model", b"<model" + prefix, 1).replace(b"<triangle ", b"<triangle " + paint + b" ")

        with pytest.raises(AssetError, match=f"painted in {program}"):
            changed(change)

    def test_negative_parts(self, changed):
        settings = '<config><object id="1"><part id="2" subtype="negative_part"/></object></config>'
        with pytest.raises(AssetError, match="negative parts"):
            changed(bytes, model_settings=settings)

    def test_no_paint_no_complaint(self, changed):
        assert len(changed(bytes, model_settings="<config/>").faces) == 12


def test_components_that_double_without_end(tmp_path):
    """Refused before lib3mf expands them; and so is one that contains itself."""
    builder = Builder()
    builder.place(builder.box())
    builder.load(tmp_path / "plain.3mf")

    def load(objects: str, last: int) -> asset.Asset:
        with zipfile.ZipFile(tmp_path / "plain.3mf") as old, zipfile.ZipFile(tmp_path / "a.3mf", "w") as new:
            for name in old.namelist():
                content = old.read(name)
                if name.endswith(".model"):
                    content = content.replace(b"</resources>", objects.encode() + b"</resources>")
                    content = re.sub(rb'(<item objectid=)"\d+"', rb'\1"%d"' % last, content)
                new.writestr(name, content)
        return asset.load(tmp_path / "a.3mf")

    def holding(number: int, inner: int) -> str:
        components = 2 * f'<component objectid="{inner}"/>'
        return f'<object id="{number}" type="model"><components>{components}</components></object>'

    with zipfile.ZipFile(tmp_path / "plain.3mf") as plain:
        (model,) = (plain.read(name) for name in plain.namelist() if name.endswith(".model"))
    first = int(re.search(rb'<object id="(\d+)"', model)[1])
    assert len(load(holding(100, first) + holding(101, 100), 101).faces) == 4 * 12
    chain = holding(100, first) + "".join(holding(100 + i, 99 + i) for i in range(1, 40))
    with pytest.raises(AssetError, match="more than 2000 parts"):
        load(chain, 139)
    with pytest.raises(AssetError, match="contains itself"):
        load(holding(100, 101) + holding(101, 100), 101)

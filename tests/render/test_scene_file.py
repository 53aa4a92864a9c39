"""Scene files: the bundled ones, what they include, the text to edit, and what is said about a broken one."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
from render_shapes import lumpy

from genmf_mi.assets import samples
from genmf_mi.core.errors import SceneError
from genmf_mi.render import bridge, scene, variant
from genmf_mi.render.scene import GRID, MESH

FOLDER = scene.find("default").parent
BUNDLED = [path for path in sorted(FOLDER.glob("[a-z]*.xml")) if "_sdf" not in path.stem]
DEFAULT = scene.standalone_xml("default", "mesh.ply")


@pytest.fixture(scope="module")
def part(tmp_path_factory) -> Path:
    """A shape without symmetry, as a PLY file."""
    import trimesh

    variant.use("cpu")
    ball = trimesh.creation.icosphere(3)
    path = tmp_path_factory.mktemp("part") / "part.ply"
    bridge.write_ply(path, lumpy(ball.vertices), np.array(ball.faces))
    return path


def image(xml: Path, mesh: Path) -> np.ndarray:
    """From the file's own camera, by Mitsuba alone."""
    return np.array(mi.render(mi.load_file(str(xml), mesh=str(mesh), azimuth="33", resolution="48"), seed=1))


@pytest.mark.parametrize("path", BUNDLED, ids=lambda path: path.stem)
class TestBundledFiles:
    def test_is_named_after_a_sample(self, path):
        assert path.stem == "default" or path.stem in samples.NAMES
        assert ElementTree.parse(path).getroot().find("default").get("name") == MESH

    def test_grid_scene_is_that_of_the_mesh(self, path):
        """Views, lights, camera and material are the same; only the shape is another."""
        defaults = [scene.read_defaults(scene.find(path.stem, holds), holds) for holds in (MESH, GRID)]
        assert defaults[1].pop(GRID) == defaults[0].pop(MESH).replace("mesh", "grid").replace(".ply", ".vol")
        assert [defaults[1].pop(name) for name in ("half", "x", "y", "z")] == ["1", "0", "0", "0"]
        assert defaults[0] == defaults[1]
        mesh, grid = (ElementTree.parse(FOLDER / f"_{holds}.xml").getroot() for holds in (MESH, GRID))
        for name in ("include", "shape/include"):
            assert mesh.find(name).get("filename") == grid.find(name).get("filename")
        assert (mesh.find("shape").get("type"), grid.find("shape").get("type")) == ("ply", "sdfgrid")
        assert mesh.find("shape").get("id") == grid.find("shape").get("id")

    def test_standalone_text(self, path, part, tmp_path):
        """One file with the same parameters, comments and image, to the last bit."""
        text = scene.standalone_xml(path.stem, "a & b.ply")
        mine = tmp_path / "my.xml"
        mine.write_text(text)
        assert "include" not in text and "No ray may slip through" in text
        assert scene.read_defaults(mine) == scene.read_defaults(path) | {"mesh": "a & b.ply"}
        assert scene.load(mine, part, radius=0.95).views == scene.load(path, part, radius=0.95).views
        np.testing.assert_array_equal(image(mine, part), image(path, part))

    def test_rays_hit_between_triangles(self, path):
        """Mitsuba takes no settings of the scene from an included file, so that each file must have this one."""
        (setting,) = ElementTree.parse(path).getroot().iterfind("boolean")
        assert (setting.get("name"), setting.get("value")) == ("embree_use_robust_intersections", "true")


def test_default_for_everything_else():
    assert scene.standalone_xml("my toy", "my toy.ply") == DEFAULT.replace('"mesh.ply"', '"my toy.ply"')


@pytest.mark.parametrize("name", ["strawberry", "strawberry_sdf", "nothing_bundled", "_mesh", "_camera"])
def test_found_by_the_name_of_the_sample(name):
    stem = "strawberry" if "straw" in name else "default"
    assert scene.find(name) == FOLDER / f"{stem}.xml"
    assert scene.find(name, GRID) == FOLDER / f"{stem}_sdf.xml"


class TestIncludes:
    """The files of users."""

    def test_copy_of_a_bundled_file(self, part, tmp_path):
        """It still finds what it includes."""
        path = tmp_path / "my.xml"
        path.write_text(scene.find("globe").read_text().replace('value="globe.ply"', 'value="my.ply"'))
        assert scene.read_defaults(path) == scene.read_defaults(scene.find("globe")) | {"mesh": "my.ply"}
        assert scene.load(path, part, radius=0.95).views == scene.load(scene.find("globe"), part, radius=0.95).views

    def test_own_file_in_a_folder(self, part, tmp_path):
        """Searched beside the file that includes it first; the first default of a name holds."""
        (tmp_path / "parts").mkdir()
        (tmp_path / "my.xml").write_text(
            '<scene version="3.0.0"><default name="samples" value="2"/><include filename="parts/rest.xml"/></scene>'
        )
        (tmp_path / "parts" / "rest.xml").write_text('<scene version="3.0.0"><include filename="more.xml"/></scene>')
        (tmp_path / "parts" / "more.xml").write_text(
            DEFAULT.replace('name="resolution" value="384"', 'name="resolution" value="40"')
        )
        (tmp_path / "more.xml").write_text('<scene version="3.0.0"/>')
        defaults = scene.read_defaults(tmp_path / "my.xml")
        assert (defaults["samples"], defaults["resolution"], defaults["mesh"]) == ("2", "40", "mesh.ply")
        loaded = scene.load(tmp_path / "my.xml", part, radius=0.95)
        assert (loaded.resolution, loaded.sensor.sampler().sample_count()) == (40, 2)
        assert scene.load(tmp_path / "my.xml", part, radius=0.95, resolution=24).resolution == 24

    @pytest.mark.parametrize(
        ("content", "message"),
        [
            ('<include filename="nowhere.xml"/>', r'my\.xml includes a file "nowhere\.xml", which does not exist'),
            ("<include/>", r'includes a file "", which does not exist'),
            ('<include filename="my.xml"/>', "which includes it in turn"),
            ('<include filename="broken.xml"/>', r"broken\.xml is not readable as XML"),
        ],
    )
    def test_what_cannot_be_included(self, content, message, part, tmp_path):
        (tmp_path / "my.xml").write_text(f'<scene version="3.0.0">{content}</scene>')
        (tmp_path / "broken.xml").write_text("<scene")
        with pytest.raises(SceneError, match=message):
            scene.load(tmp_path / "my.xml", part, radius=0.95)


MATERIAL = DEFAULT[DEFAULT.index("        <bsdf") : DEFAULT.index("        </bsdf>") + len("        </bsdf>\n")]
BROKEN = {
    "empty": ("", "not readable as XML"),
    "cut off": (DEFAULT[:700], "not readable as XML"),
    "not text": ("\x00\x01", "not readable as XML"),
    "no mesh": (DEFAULT.replace('name="mesh" value="mesh.ply"', 'name="shape" value="mesh.ply"'), 'name="mesh"'),
    "another material": (DEFAULT.replace(MATERIAL, '<bsdf type="diffuse"/>'), "twolight"),
    "one more material": (DEFAULT.replace("    <shape", '    <shape type="rectangle"/>\n    <shape'), "twolight"),
    "a typing error": (DEFAULT.replace('"sharpness"', '"sharpnes"'), "sharpnes"),
    "a bad value": (DEFAULT.replace('name="ambient" value="0.2"', 'name="ambient" value="2"'), "ambient"),
    "no sensor": (DEFAULT[: DEFAULT.index("    <sensor")] + DEFAULT[DEFAULT.index("    <shape") :], "no sensor"),
    "another integrator": (DEFAULT.replace('"monochrome"', '"path"'), "monochrome"),
    "no integrator": (DEFAULT.replace('<integrator type="monochrome"/>', ""), "monochrome"),
    "unknown plugin": (DEFAULT.replace('"multijitter"', '"jittery"'), "jittery"),
    "orthographic": (DEFAULT.replace('"perspective"', '"orthographic"').replace(
        '<float name="fov" value="28"/>', ""), "perspective"),
    "a sphere": (DEFAULT.replace('type="ply"', 'type="sphere"').replace(
        '<string name="filename" value="$mesh"/>', '<string name="id" value="$mesh"/>'), "mesh|ply"),
    "no ids": (DEFAULT.replace(' id="camera"', "").replace(' id="object"', ""), "id"),
    "shared material": (DEFAULT.replace(MATERIAL, '<ref id="m"/>').replace(
        "    <shape", MATERIAL.replace("<bsdf", '<bsdf id="m"') + "    <shape"), "material"),
    "not square": (DEFAULT.replace('name="height" value="$resolution"', 'name="height" value="50"'), "square"),
    "no views": (DEFAULT.replace('"0:20 60:-10 120:20 180:-10 240:20 300:-10"', '""'), "views"),
    "bad views": (DEFAULT.replace('"0:20 60', '"0:20:5 60'), "azimuth:elevation"),
}  # fmt: skip


@pytest.mark.parametrize("name", BROKEN)
def test_what_is_wrong_with_a_scene_is_said(name, part, tmp_path):
    text, message = BROKEN[name]
    assert text != DEFAULT
    path = tmp_path / "my.xml"
    path.write_text(text)
    with pytest.raises(SceneError, match=message) as caught:
        scene.load(path, part, radius=0.95)
    assert "my.xml" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_no_such_file(part, tmp_path):
    with pytest.raises(SceneError, match="no scene file"):
        scene.load(tmp_path / "nowhere.xml", part, radius=1.0)
    with pytest.raises(SceneError, match="XML"):
        scene.load(tmp_path, part, radius=1.0)

"""Print files: what is written is what was meant, in the right unit, frame and colours, or nothing at all."""

from __future__ import annotations

import json
import zipfile
from dataclasses import replace

import lib3mf
import meshio
import numpy as np
import pytest
import trimesh
from lxml import etree

from genmf_mi.assets import asset
from genmf_mi.core.colour import to_linear
from genmf_mi.core.errors import OutputError
from genmf_mi.core.frame import Frame
from genmf_mi.fabrication import files as fabricate
from genmf_mi.fabrication.checks import check

BALL = trimesh.creation.icosphere(subdivisions=3)


@pytest.fixture(scope="module")
def part() -> tuple[np.ndarray, np.ndarray, Frame, np.ndarray]:
    """An egg of 60 × 120 × 40 file units, off centre, to be printed 100 mm tall: vertices, faces, frame, linear RGB."""
    vertices = np.asarray(BALL.vertices) * [30, 60, 20] + np.array([5, 7, 9])
    frame = Frame.of(vertices, 100.0)
    rgb = np.random.default_rng(0).uniform(0, 1, (len(vertices), 3)) ** 3
    return frame.normalise(vertices), np.asarray(BALL.faces), frame, rgb


@pytest.fixture
def written(tmp_path, part):
    return {suffix: tmp_path / name for suffix, name in _write(tmp_path, part).items()}


def _write(folder, part, title="Ei & <Schale> №1"):
    vertices, faces, frame, rgb = part
    return fabricate.write(folder, vertices, faces, frame, rgb, title)


def assert_printable(vertices: np.ndarray, faces: np.ndarray) -> None:
    np.testing.assert_allclose(np.ptp(vertices, axis=0), [50, 100 / 3, 100], atol=1e-3)  # x, depth, height
    assert vertices[:, 2].min() == pytest.approx(0, abs=1e-4)
    judged = trimesh.Trimesh(vertices, faces, process=True)
    assert judged.is_watertight
    assert judged.volume == pytest.approx(BALL.volume * 30 * 60 * 20 * (100 / 120) ** 3, rel=1e-4)


def test_stl_as_meshio_reads_it(written):
    mesh = meshio.read(written["stl"])
    assert_printable(mesh.points.astype(np.float64), mesh.cells_dict["triangle"])
    assert written["stl"].stat().st_size == 84 + 50 * len(BALL.faces)


def test_3mf_as_trimesh_and_lib3mf_read_it(written):
    mesh = trimesh.load_mesh(written["3mf"], process=False)
    assert mesh.units == "millimeter"
    assert_printable(np.asarray(mesh.vertices), np.asarray(mesh.faces))
    model = lib3mf.get_wrapper().CreateModel()
    reader = model.QueryReader("3mf")
    reader.SetStrictModeActive(True)
    reader.ReadFromFile(str(written["3mf"]))
    assert reader.GetWarningCount() == 0
    meshes = model.GetMeshObjects()
    assert meshes.MoveNext()
    assert meshes.GetCurrentMeshObject().IsManifoldAndOriented()
    assert model.GetMetaDataGroup().GetMetaDataByKey("", "Title").GetValue() == "Ei & <Schale> №1"


def test_3mf_says_its_unit_in_the_xml(written):
    with zipfile.ZipFile(written["3mf"]) as archive:
        root = etree.fromstring(archive.read("3D/3dmodel.model"))
    assert root.get("unit") == "millimeter"
    assert len(root.findall(".//{*}item")) == 1


def test_glb_is_in_the_frame_of_the_asset_with_linear_colours(written, part):
    vertices, faces, frame, rgb = part
    mesh = trimesh.load_mesh(written["glb"], process=False)
    np.testing.assert_allclose(mesh.vertices, frame.restore(vertices), atol=1e-4)
    np.testing.assert_array_equal(mesh.faces, faces)
    np.testing.assert_allclose(mesh.vertex_normals, trimesh.Trimesh(mesh.vertices, faces).vertex_normals, atol=0.02)
    back = asset.load(written["glb"])
    np.testing.assert_allclose(back.albedo.colours, rgb, atol=1e-5)  # 16 bits


def test_glb_far_from_the_origin_keeps_every_detail(tmp_path, part):
    """As scans with map coordinates are: a tenth of a millimetre at five thousand kilometres."""
    vertices, faces, frame, rgb = part
    away = replace(frame, centre=(500_123.25, 212.5, -4_649_776.75), scale=1.0)
    found = fabricate.write(tmp_path, vertices, faces, away, rgb, "rock")
    for back in (trimesh.load_mesh(found["glb"], process=False), asset.load(found["glb"])):
        np.testing.assert_allclose(back.vertices, away.restore(vertices), atol=1e-6)


def test_glb_follows_the_specification(written):
    data = written["glb"].read_bytes()
    assert int.from_bytes(data[8:12], "little") == len(data)
    size = int.from_bytes(data[12:16], "little")
    assert size % 4 == 0
    tree = json.loads(data[20 : 20 + size])
    for accessor in tree["accessors"]:
        view = tree["bufferViews"][accessor["bufferView"]]
        item = {5126: 4, 5123: 2, 5125: 4}[accessor["componentType"]] * {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[
            accessor["type"]
        ]
        assert view["byteLength"] == item * accessor["count"]
        assert view["byteOffset"] % 4 == 0
        assert item % 4 == 0  # vertex attributes are aligned to four bytes
    position = tree["accessors"][tree["meshes"][0]["primitives"][0]["attributes"]["POSITION"]]
    assert position["max"][1] == pytest.approx(67, abs=1e-4)


def test_dark_colours_are_not_banded(tmp_path, part):
    vertices, faces, frame, _ = part
    dark = np.repeat(to_linear(np.linspace(0, 0.1, len(vertices)))[:, None], 3, axis=1)
    fabricate.write(tmp_path, vertices, faces, frame, dark, "dark")
    back = asset.load(tmp_path / "refined.glb").albedo.colours
    assert len(np.unique(back)) > 300  # eight bits of linear light would leave three


def test_without_colours_there_is_no_colour_attribute(tmp_path, part):
    vertices, faces, frame, _ = part
    fabricate.write(tmp_path, vertices, faces, frame, None, "plain")
    assert not asset.load(tmp_path / "refined.glb").textured


def test_two_writes_of_meshes_are_the_same_bytes(tmp_path, part):
    for folder in ("a", "b"):
        _write(tmp_path / folder, part)
    for name in ("refined.stl", "refined.glb"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


@pytest.mark.parametrize("name", ["write_3mf", "_write_stl", "write_glb"])
def test_a_file_that_reads_back_differently_is_not_left_behind(tmp_path, part, monkeypatch, name):
    honest = getattr(fabricate, name)

    def crooked(path, vertices, *rest):
        honest(path, vertices * 1.01, *rest)

    monkeypatch.setattr(fabricate, name, crooked)
    with pytest.raises(OutputError, match="does not read back"):
        _write(tmp_path, part)
    assert not (tmp_path / f"refined.{name[-3:]}").exists()
    assert not list(tmp_path.glob(".*"))


@pytest.mark.parametrize("name", ["write_3mf", "_write_stl", "write_glb"])
def test_a_full_disk_leaves_the_old_file(tmp_path, part, monkeypatch, full_disk, name):
    _write(tmp_path, part)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    honest = getattr(fabricate, name)

    def full(*arguments):
        with full_disk():
            honest(*arguments)

    monkeypatch.setattr(fabricate, name, full)
    with pytest.raises(OutputError, match=rf"refined\.{name[-3:]}: File too large"):
        _write(tmp_path, part)
    after = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert set(after) == set(before) and after[f"refined.{name[-3:]}"] == before[f"refined.{name[-3:]}"]


def test_a_folder_that_cannot_be_made(tmp_path, part):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(OutputError, match="cannot write"):
        _write(tmp_path / "file" / "out", part)


def test_checks_of_a_plate_with_known_thickness():
    plate = trimesh.creation.box(extents=[40, 1.5, 30]).subdivide_to_size(3)
    found = check(np.asarray(plate.vertices), np.asarray(plate.faces))
    assert found["watertight"]
    assert found["bodies"] == 1
    assert found["self_intersections"] == 0
    assert found["volume_mm3"] == pytest.approx(40 * 1.5 * 30)
    assert found["area_mm2"] == pytest.approx(plate.area)
    assert found["min_thickness_mm"] == pytest.approx(1.5, abs=1e-3)
    np.testing.assert_allclose(found["size_mm"], [40, 1.5, 30])


def test_checks_of_open_and_tangled_meshes():
    assert not check(np.asarray(BALL.vertices) * 9, np.asarray(BALL.faces)[1:])["watertight"]
    inside_out = check(np.asarray(BALL.vertices) * 9, np.asarray(BALL.faces)[:, ::-1])
    assert not inside_out["watertight"]
    assert inside_out["min_thickness_mm"] == 0
    both = trimesh.util.concatenate([BALL, BALL.copy().apply_translation([0.7, 0.1, 0.05])])
    found = check(np.asarray(both.vertices) * 9, np.asarray(both.faces))
    assert found["bodies"] == 2
    assert found["self_intersections"] > 100

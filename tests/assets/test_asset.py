"""Loading: PLY and STL, the axis that points up, refusals, and the colour nearest to a point."""

from __future__ import annotations

import io
import time

import numpy as np
import pytest
import trimesh
from PIL import Image

from genmf_mi.assets import asset
from genmf_mi.assets.asset import Asset
from genmf_mi.core.colour import bytes_to_linear, to_linear
from genmf_mi.core.errors import AssetError, ConfigError

TRIANGLE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], dtype=np.float64)


def ball(**visual) -> trimesh.Trimesh:
    made = trimesh.creation.icosphere(subdivisions=2)
    return trimesh.Trimesh(made.vertices, made.faces, process=False, **visual)


def test_ply_vertex_colours_are_srgb(tmp_path):
    rgb = np.random.default_rng(0).integers(0, 256, (162, 3), dtype=np.uint8)
    ball(vertex_colors=rgb).export(tmp_path / "a.ply")
    found = asset.load(tmp_path / "a.ply")
    np.testing.assert_allclose(found.closest_albedo(ball().vertices), bytes_to_linear(rgb), atol=1e-6)
    assert found.textured
    assert found.name == "a"
    assert found.source == tmp_path / "a.ply"


def test_ply_face_colours_have_sharp_borders(tmp_path):
    rgb = np.random.default_rng(0).integers(0, 256, (320, 3), dtype=np.uint8)
    ball(face_colors=rgb).export(tmp_path / "a.ply")
    found = asset.load(tmp_path / "a.ply")
    weights = np.random.default_rng(1).dirichlet([1, 1, 1], 320)
    np.testing.assert_allclose(found.albedo_at(np.arange(320), weights), bytes_to_linear(rgb), atol=1e-6)


def test_ply_texture_beside_it_and_missing(tmp_path):
    picture = np.array([[[255, 0, 0]], [[0, 0, 255]]], dtype=np.uint8)  # red above blue
    text = (
        "ply\nformat ascii 1.0\ncomment TextureFile two.png\nelement vertex 3\nproperty float x\nproperty float y\n"
        "property float z\nproperty float s\nproperty float t\nelement face 1\nproperty list uchar int vertex_indices\n"
        "end_header\n0 0 0 0.5 0.25\n1 0 0 0.5 0.25\n0 1 0 0.5 0.75\n3 0 1 2\n"
    )
    (tmp_path / "a.ply").write_text(text)
    with pytest.raises(AssetError, match=r"two\.png, which is not beside it"):
        asset.load(tmp_path / "a.ply")
    Image.fromarray(picture).save(tmp_path / "two.png")
    found = asset.load(tmp_path / "a.ply")
    np.testing.assert_allclose(found.closest_albedo(TRIANGLE[[0, 2]]), [[0, 0, 1], [1, 0, 0]], atol=1e-6)


def test_stl_is_z_up_unless_told_otherwise(tmp_path):
    tower = trimesh.creation.box(extents=[1, 2, 5])
    tower.export(tmp_path / "a.stl")
    assert np.ptp(asset.load(tmp_path / "a.stl").vertices, axis=0).tolist() == [1, 5, 2]
    assert np.ptp(asset.load(tmp_path / "a.stl", up="y").vertices, axis=0).tolist() == [1, 2, 5]
    found = asset.load(tmp_path / "a.stl")
    assert trimesh.Trimesh(found.vertices, found.faces).volume == pytest.approx(10)
    assert not found.textured


@pytest.mark.parametrize("up", ["x", "-x", "y", "-y", "z", "-z"])
def test_any_axis_may_point_upwards(tmp_path, up):
    """A tower whose top, a tetrahedron, is at that end; the faces stay outwards."""
    direction = np.array([up.endswith(axis) for axis in "xyz"]) * (-1.0 if up.startswith("-") else 1.0)
    tower = trimesh.creation.cone(1.0, 4.0, sections=8)
    tower.apply_transform(trimesh.geometry.align_vectors([0, 0, 1], direction))
    tower.export(tmp_path / "a.obj")
    found = asset.load(tmp_path / "a.obj", up=up)
    assert np.ptp(found.vertices[:, 1]) == pytest.approx(4, abs=1e-5)
    assert found.vertices[:, 1].mean() < np.ptp(found.vertices[:, 1]) / 2 + found.vertices[:, 1].min()
    assert trimesh.Trimesh(found.vertices, found.faces).volume == pytest.approx(tower.volume, rel=1e-5)


def test_no_such_axis(tmp_path):
    ball().export(tmp_path / "a.obj")
    with pytest.raises(ConfigError, match="no axis"):
        asset.load(tmp_path / "a.obj", up="w")


def test_sixteen_bit_and_palette_pictures(tmp_path):
    from genmf_mi.assets.part import decode_image

    def stored(image) -> np.ndarray:
        image.save(tmp_path / "a.png")
        return decode_image((tmp_path / "a.png").read_bytes(), "a.png")

    deep = Image.fromarray(np.array([[0, 257 * 128, 65535]], dtype=np.uint16))
    np.testing.assert_array_equal(stored(deep)[0, :, 0], [0, 128, 255])
    palette = Image.fromarray(np.array([[[255, 0, 0], [0, 0, 255]]], dtype=np.uint8)).quantize(2)
    np.testing.assert_array_equal(stored(palette), [[[255, 0, 0], [0, 0, 255]]])


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("gone.glb", None, "does not exist"),
        ("empty.glb", b"", "is empty"),
        ("model.fbx", b"Kaydara FBX Binary", r"unknown kind \(\.fbx\)"),
        ("model", b"solid", r"unknown kind \(no suffix\)"),
        ("text.glb", b"hello", "is not glTF"),
        ("old.gltf", b'{"asset": {"version": "1.0"}}', "glTF 1"),
        ("none.gltf", b'{"asset": {"version": "2.0"}}', "holds no triangles"),
        ("broken.gltf", b'{"asset": {"version": "2.0"}, "nodes": [{"mesh": 3}]}', "cannot be read as GLTF"),
        ("zip.3mf", b"PK\x03\x04 nothing more", "cannot be read as 3MF"),
        ("short.stl", b"\0" * 90, r"short\.stl"),
        ("points.ply", b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n"
         b"property float z\nend_header\n0 0 0\n", "holds no triangles"),
        ("half.ply", b"ply\nformat binary_little_endian 1.0\nelement vertex 9\nproperty float x\n", r"half\.ply"),
        ("points.obj", b"v 0 0 0\nv 1 0 0\n", "holds no triangles"),
        ("noise.obj", bytes(range(256)) * 20, r"noise\.obj"),
        ("nan.obj", b"v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "not numbers"),
        ("dot.obj", b"v 1 1 1\nv 1 1 1\nv 1 1 1\nf 1 2 3\n", "has no size"),
        ("beyond.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 7\n", r"beyond\.obj"),
    ],
    ids=lambda value: value if isinstance(value, str) and "." in value and " " not in value else "",
)  # fmt: skip
def test_bad_files_are_refused_by_name(tmp_path, name, content, message):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(AssetError, match=message) as refusal:
        asset.load(tmp_path / name)
    assert name in str(refusal.value)


def test_a_folder_is_not_a_file(tmp_path):
    (tmp_path / "a.glb").mkdir()
    with pytest.raises(AssetError, match="is a folder"):
        asset.load(tmp_path / "a.glb")


def test_unused_vertices_may_be_anything():
    made = Asset.from_arrays("a", np.vstack([TRIANGLE, [[np.nan] * 3]]), [[0, 1, 2]])
    assert len(made.vertices) == 4


def test_arrays_that_do_not_fit_are_refused():
    with pytest.raises(AssetError, match="does not fit 3 vertices"):
        Asset.from_arrays("a", TRIANGLE, [[0, 1, 2]], colours=np.ones((2, 3)))
    with pytest.raises(AssetError, match="needs texture coordinates"):
        Asset.from_arrays("a", TRIANGLE, [[0, 1, 2]], texture=np.zeros((1, 1, 3), np.uint8))
    with pytest.raises(AssetError, match="missing vertices"):
        Asset.from_arrays("a", TRIANGLE, [[0, 1, 3]])
    with pytest.raises(AssetError, match="holds no triangles"):
        Asset.from_arrays("a", TRIANGLE, [])


def test_nearest_colour_agrees_with_trimesh():
    rng = np.random.default_rng(0)
    shape = ball()
    colours = rng.uniform(0, 1, (len(shape.vertices), 3)).astype(np.float32)
    made = Asset.from_arrays("ball", shape.vertices, shape.faces, colours=colours)
    points = rng.normal(size=(300, 3))
    closest, _, index = trimesh.proximity.closest_point_naive(shape, points)
    weights = trimesh.triangles.points_to_barycentric(shape.triangles[index], closest)
    expected = np.einsum("nk,nkc->nc", weights, colours[shape.faces[index]])
    np.testing.assert_allclose(made.closest_albedo(points), expected, atol=1e-4)


def thin_wall() -> Asset:
    """A plate 0.01 thick, red above (y = 0.01) and blue below."""
    plate = trimesh.creation.box(extents=[1, 0.01, 1])
    faces = plate.faces
    vertices = plate.vertices[faces].reshape(-1, 3) + np.array([0, 0.005, 0])
    top = np.repeat(plate.face_normals[:, 1] > 0.5, 3)
    colours = np.where(top[:, None], [1.0, 0, 0], [0, 0, 1.0])
    return Asset.from_arrays("plate", vertices, np.arange(len(vertices)).reshape(-1, 3), colours=colours)


def test_normals_choose_the_side_of_a_thin_wall():
    plate, rng = thin_wall(), np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-0.4, 0.4, 100), np.full(100, 0.004), rng.uniform(-0.4, 0.4, 100)])
    up = np.tile([0.1, 1.0, 0.0], (100, 1))
    np.testing.assert_allclose(plate.closest_albedo(points), np.tile([0, 0, 1], (100, 1)))  # the nearer side
    np.testing.assert_allclose(plate.closest_albedo(points, up), np.tile([1, 0, 0], (100, 1)))
    both = np.concatenate([up, -up])
    sides = plate.closest_albedo(np.concatenate([points, points]), both)
    np.testing.assert_allclose(sides, np.repeat([[1, 0, 0], [0, 0, 1]], 100, axis=0))


def test_normals_do_not_reach_across_the_object():
    shape = ball()
    colours = np.where(shape.vertices[:, :1] > 0, [1.0, 0, 0], [0, 0, 1.0])
    made = Asset.from_arrays("ball", shape.vertices, shape.faces, colours=colours)
    point, against = np.array([[1.0, 0, 0]]), np.array([[-1.0, 0, 0]])
    few = np.concatenate([np.tile(point, (9, 1)), point]), np.concatenate([np.tile(-against, (9, 1)), against])
    np.testing.assert_allclose(made.closest_albedo(*few), np.tile([1, 0, 0], (10, 1)), atol=1e-6)


def test_inside_out_file_keeps_its_sides():
    plate = thin_wall()
    turned = Asset.from_arrays("plate", plate.vertices, plate.faces[:, ::-1], colours=plate.albedo.colours)
    points, up = np.array([[0.1, 0.006, 0.1], [0.1, 0.0061, 0.2]]), np.array([[0, 1.0, 0]] * 2)
    np.testing.assert_allclose(turned.closest_albedo(points, up), [[1, 0, 0]] * 2)


def test_half_a_million_points_take_seconds():
    shape = trimesh.creation.icosphere(subdivisions=5)
    uv = shape.vertices[:, :2]
    picture = np.random.default_rng(0).integers(0, 256, (512, 512, 3), dtype=np.uint8)
    made = Asset.from_arrays("ball", shape.vertices, shape.faces, uv=uv, texture=picture)
    points = np.random.default_rng(1).normal(size=(500_000, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    start = time.process_time()
    found = made.closest_albedo(points, points)
    assert found.shape == (500_000, 3)
    assert time.process_time() - start < 8  # about 1.5 s on an idle machine


def test_texture_in_memory_is_srgb_and_starts_at_the_top():
    picture = np.array([[[188] * 3], [[0] * 3]], dtype=np.uint8)
    made = Asset.from_arrays("a", TRIANGLE, [[0, 1, 2]], uv=np.full((3, 2), 0.25), texture=picture)
    np.testing.assert_allclose(
        made.albedo_at(np.array([0]), np.array([[0.2, 0.3, 0.5]])), to_linear(188 / 255), rtol=1e-6
    )


def test_real_assets_load(assets):
    for path in sorted(assets.glob("*.glb")):
        found = asset.load(path)
        assert found.textured
        rgb = found.albedo_at(np.arange(len(found.faces)), np.full((len(found.faces), 3), 1 / 3))
        assert np.isfinite(rgb).all()
        assert rgb.std() > 0.01
        np.testing.assert_allclose(np.ptp(found.vertices, axis=0).max(), 1, atol=1e-3)


class TestBeforeItIsTooLate:
    """What would be refused after minutes is refused at once."""

    def test_a_texture_of_too_many_pixels(self):
        from genmf_mi.assets.part import decode_image

        def stored(side: int, mode: str) -> bytes:
            stream = io.BytesIO()
            Image.new(mode, (side, side)).save(stream, "PNG", compress_level=1)
            return stream.getvalue()

        for side in (10_001, 14_000):
            with pytest.raises(AssetError, match="Scale it down"):
                decode_image(stored(side, "1"), "bomb.png")

    @pytest.mark.parametrize("scale", [1e16, 1e100, 1e200])
    def test_huge_coordinates(self, scale):
        with pytest.raises(AssetError, match="coordinates of"):
            Asset.from_arrays("a", TRIANGLE * scale, [[0, 1, 2]])

    def test_one_vertex_far_away(self):
        mesh = ball()
        vertices = np.array(mesh.vertices)
        vertices[5] = 1e8
        with pytest.raises(AssetError, match=r"a few vertices .* farther away"):
            Asset.from_arrays("a", vertices, mesh.faces)

    def test_colours_that_are_not_numbers(self):
        colours = np.ones((3, 3))
        colours[1] = np.nan
        with pytest.raises(AssetError, match="colours that are not numbers"):
            Asset.from_arrays("a", TRIANGLE, [[0, 1, 2]], colours=colours)

"""The bundled samples: closed smooth solids whose detail is in the brightness of the texture alone."""

from __future__ import annotations

from functools import cache

import manifold3d
import numpy as np
import pytest
import trimesh
from scipy.ndimage import gaussian_filter

from genmf_mi.assets import samples
from genmf_mi.assets.samples.charts import GUTTER, Chart, assemble, cast, cube_sphere
from genmf_mi.core.errors import AssetError, OutputError


@cache
def sample(name: str) -> trimesh.Trimesh:
    return samples.make(name, resolution=512)


@cache
def welded(name: str) -> trimesh.Trimesh:
    mesh = trimesh.Trimesh(sample(name).vertices, sample(name).faces, process=False)
    mesh.merge_vertices(digits_vertex=7)
    return mesh


@cache
def value(name: str) -> np.ndarray:
    """The linear HSV value of the texture, ``[512,512]``, row 0 at v = 0: what the relief has to show."""
    code = np.asarray(sample(name).visual.material.baseColorTexture)[::-1].max(axis=-1) / 255
    return np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)


@pytest.mark.parametrize("name", samples.NAMES)
class TestEverySample:
    def test_is_one_closed_manifold(self, name: str) -> None:
        mesh = welded(name)
        solid = manifold3d.Manifold(manifold3d.Mesh(mesh.vertices.astype(np.float32), mesh.faces.astype(np.uint32)))
        assert solid.status() == manifold3d.Error.NoError
        assert mesh.is_watertight and mesh.is_winding_consistent and mesh.body_count == 1 and mesh.euler_number == 2
        assert mesh.volume == pytest.approx(solid.volume(), rel=1e-3) and mesh.volume > 0

    def test_size_is_one_and_centred(self, name: str) -> None:
        low, high = sample(name).bounds
        assert max(high - low) == pytest.approx(1)
        assert low + high == pytest.approx(np.zeros(3), abs=1e-12)
        assert 10_000 <= len(sample(name).faces) <= 40_000

    def test_stands_on_a_flat_base(self, name: str) -> None:
        mesh = welded(name)
        on_bed = (mesh.triangles[:, :, 1] < mesh.bounds[0, 1] + 1e-6).all(axis=1)
        assert mesh.area_faces[on_bed].sum() > 0.015 or name == "leaf"

    def test_surface_is_smooth(self, name: str) -> None:
        """But for rims, neighbouring faces meet at a small angle."""
        angles = np.degrees(welded(name).face_adjacency_angles)
        assert np.percentile(angles, 95) < 18
        assert angles.max() < 95

    def test_same_twice(self, name: str) -> None:
        first, second = samples.make(name, resolution=128), samples.make(name, resolution=128)
        assert first.export(file_type="glb") == second.export(file_type="glb")

    def test_detail_is_bright_against_its_ground(self, name: str) -> None:
        """On a scale of 8 texels the linear value varies by far more than a soft blush would."""
        detail = value(name) - gaussian_filter(value(name), 8)
        assert detail.std() > 0.05
        assert np.ptp(np.percentile(value(name), [5, 95])) > 0.25

    def test_charts_do_not_overlap_and_keep_their_gutter(self, name: str) -> None:
        uv, faces = sample(name).visual.uv, sample(name).faces
        corners = uv[faces]
        a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        signed = (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2
        # Cells of a regular grid, all of one sign: they can overlap only if their boxes do.
        assert signed.min() > 0
        charts = trimesh.Trimesh(np.c_[uv, np.zeros(len(uv))], faces, process=False).split(only_watertight=False)
        boxes = np.array([np.r_[chart.bounds[0, :2], chart.bounds[1, :2]] for chart in charts])
        assert signed.sum() == pytest.approx(np.prod(boxes[:, 2:] - boxes[:, :2], axis=1).sum())
        for i, box in enumerate(boxes):
            others = np.delete(boxes, i, axis=0)
            gap = np.maximum(others[:, :2] - box[2:], box[:2] - others[:, 2:]).max(axis=1)
            assert (gap * 512).min() > 2 * GUTTER - 1
        assert boxes.min() * 512 > GUTTER - 1 and (1 - boxes.max()) * 512 > GUTTER - 1

    def test_texture_agrees_across_seams(self, name: str) -> None:
        """Vertices in one place have one colour, from whichever chart it is read."""
        mesh = sample(name)
        row, column = (mesh.visual.uv[:, ::-1] * 512).T
        image = value(name)
        # Bilinear filtering as a renderer does it.
        r, c = np.floor(row - 0.5).astype(int), np.floor(column - 0.5).astype(int)
        y, x = row - 0.5 - r, column - 0.5 - c
        read = (image[r, c] * (1 - x) + image[r, c + 1] * x) * (1 - y) + (
            image[r + 1, c] * (1 - x) + image[r + 1, c + 1] * x
        ) * y
        _, where = np.unique(np.round(mesh.vertices, 7), axis=0, return_inverse=True)
        where = where.reshape(-1)
        lowest, highest = np.full(where.max() + 1, np.inf), np.full(where.max() + 1, -np.inf)
        np.minimum.at(lowest, where, read)
        np.maximum.at(highest, where, read)
        seam = np.bincount(where) > 1
        # What is left is interpolation along the border, at the edges of the pattern.
        assert seam.sum() > 100 and (highest - lowest)[seam].mean() < 0.005

    def test_triangles_get_a_fair_share_of_the_texture(self, name: str) -> None:
        """Between the 2nd and 98th percentile of area, texels per unit of surface vary by less than a factor of 8."""
        corners = sample(name).visual.uv[sample(name).faces]
        a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        density = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2 / sample(name).area_faces
        order = np.argsort(density)
        share = np.cumsum(sample(name).area_faces[order]) / sample(name).area
        low, high = np.interp([0.02, 0.98], share, density[order])
        assert high / low < 8


@pytest.mark.parametrize("name", samples.NAMES)
def test_seam_colour_is_painted_at_the_vertex(name: str) -> None:
    """The texel under a vertex holds what ``paint`` gives for the vertex itself."""
    from importlib import import_module

    module = import_module(f"genmf_mi.assets.samples.{name}")
    charts = module.charts()
    points = np.concatenate([chart.points.reshape(-1, 3) for chart in charts])
    texel = 2 * max(np.ptp(points, axis=0)) / 512
    colour = module.paint(points, texel)
    uv = (sample(name).visual.uv * 512).astype(int)
    read = np.asarray(sample(name).visual.material.baseColorTexture)[511 - uv[:, 1], uv[:, 0]] / 255
    # Half a texel apart, which matters only at edges.
    assert np.median(np.abs(read - colour)) < 0.01
    assert np.mean(np.abs(read - colour)) < 0.06


def test_strawberry_seeds_are_brighter_than_the_rim() -> None:
    from genmf_mi.assets.samples import strawberry

    seeds, down = strawberry._seeds()
    assert 150 < len(seeds) < 400
    across = np.cross(down, seeds / np.linalg.norm(seeds, axis=1, keepdims=True))
    middle, rim, ground = (strawberry.paint(seeds + k * across, 0.002).max(axis=1) for k in (0, 0.0185, 0.036))
    assert np.median(middle**2.2) > np.median(ground**2.2) + 0.3
    assert np.median(rim**2.2) < np.median(ground**2.2) - 0.15


def test_cast_and_cube_sphere_against_a_ball() -> None:
    def ball(points: np.ndarray) -> np.ndarray:
        return np.linalg.norm(points - [0.2, 0, 0], axis=-1) - 0.7

    rays = np.random.default_rng(0).standard_normal((100, 3))
    assert np.linalg.norm(cast(ball, rays) - [0.2, 0, 0], axis=1) == pytest.approx(np.full(100, 0.7), abs=1e-8)
    mesh = assemble(cube_sphere(ball, 24), lambda points, texel: np.abs(points), 64)
    mesh.merge_vertices(merge_tex=True)
    assert mesh.is_watertight and mesh.volume == pytest.approx(np.pi / 6, rel=0.01)


def test_colours_land_where_the_points_are() -> None:
    """A plane painted with its own coordinates: red grows with u, green with v, and v is up in the texture."""
    x, y = np.meshgrid(np.linspace(0, 1, 5), np.linspace(0, 1, 5))
    chart = Chart(np.stack([x, y, 0 * x], axis=-1), (0, 0, 1, 1))
    mesh = assemble([chart], lambda points, texel: points, 64)
    image = np.asarray(mesh.visual.material.baseColorTexture)
    assert image[0, 0].tolist() == [0, 255, 0] and image[-1, -1].tolist() == [255, 0, 0]
    assert mesh.visual.uv.min() == (GUTTER + 0.5) / 64 and mesh.face_normals[:, 2].min() == 1


def test_file_reads_back_and_is_reused(tmp_path) -> None:
    path = samples.write("strawberry", tmp_path)
    assert path == tmp_path / "strawberry.glb"
    (mesh,) = trimesh.load_scene(path).geometry.values()
    assert len(mesh.faces) == len(sample("strawberry").faces)
    assert mesh.visual.material.baseColorTexture.size == (1024, 1024)
    written = path.stat().st_mtime_ns
    samples.write("strawberry", tmp_path)
    assert path.stat().st_mtime_ns == written
    path.write_bytes(path.read_bytes()[:1000])
    samples.write("strawberry", tmp_path)
    assert path.stat().st_size > 1000 and list(tmp_path.iterdir()) == [path]


def test_unknown_name_and_unwritable_folder(tmp_path) -> None:
    with pytest.raises(AssetError, match="strawberry"):
        samples.make("durian")
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError):
        samples.write("strawberry", tmp_path / "file")

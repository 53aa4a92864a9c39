"""What the part should look like: the textured object itself, or given pictures of it."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from PIL import Image
from reference_pictures import ball, picture

from genmf_mi.core.colour import to_linear
from genmf_mi.core.errors import AssetError, ConfigError
from genmf_mi.render import bridge, scene, target, variant
from genmf_mi.render.scene import RenderSettings, View

VIEWS = (View(10, 20), View(200, -30))


class TestSubdivide:
    def test_keeps_the_surface(self):
        vertices, faces = ball(2)
        fine, points, field = target.subdivide(faces, vertices, vertices[:, 0])
        before, after = trimesh.Trimesh(vertices, faces, process=False), trimesh.Trimesh(points, fine, process=False)
        assert len(fine) == 4 * len(faces)
        assert after.is_watertight and after.is_winding_consistent
        assert (after.area, after.volume) == pytest.approx((before.area, before.volume), rel=1e-12)
        assert after.euler_number == before.euler_number
        np.testing.assert_array_equal(points[: len(vertices)], vertices)
        np.testing.assert_allclose(field, points[:, 0], atol=1e-15)  # linear along the edges

    def test_same_triangles_as_trimesh(self):
        vertices, faces = ball(1)
        fine, points = target.subdivide(faces, vertices)
        theirs = trimesh.remesh.subdivide(vertices, faces)

        def centres(points, faces):
            rows = np.round(points[faces].mean(axis=1), 9)
            return rows[np.lexsort(rows.T)]

        np.testing.assert_allclose(centres(points, fine), centres(*theirs), atol=1e-9)

    def test_open_surface(self):
        fine, points = target.subdivide(np.array([[0, 1, 2], [2, 1, 3]]), np.eye(4, 3))
        assert len(points) == 4 + 5 and len(fine) == 8


def part_and_reference(folder: Path, albedo, monkeypatch, pictures: tuple = ()) -> tuple[scene.Scene, target.Reference]:
    """The part and its reference; the reference's triangles are split twice."""
    variant.use("cpu")
    vertices, faces = ball(5)
    monkeypatch.setattr(target, "FINEST", 16 * len(faces))
    xml, settings = scene.find("default"), RenderSettings(radius=0.95, resolution=96, samples=16)
    normals = bridge.write_ply(folder / "part.ply", vertices, faces)
    reference = target.build_reference(xml, folder, vertices, faces, normals, albedo, settings, pictures)
    assert len(trimesh.load(folder / target.FILE, process=False).faces) == 16 * len(faces)
    return scene.load(xml, folder / "part.ply", **asdict(settings)), reference


def plain(rgb: tuple[float, float, float]):
    return lambda points, normals: np.tile(np.float32(rgb), (len(points), 1))


class TestReference:
    def test_an_object_of_one_colour_is_its_own_target(self, tmp_path, monkeypatch):
        """Pixel by pixel, though the two meshes differ in their number of triangles."""
        part, reference = part_and_reference(tmp_path, plain((0.2, 0.7, 0.4)), monkeypatch)
        ours, theirs = bridge.render(part, VIEWS, seed=4), reference.render(VIEWS, seed=4)
        assert (0.7 * ours.grey - theirs.grey).abs().max() < 1e-6
        assert (ours.normal - theirs.normal).abs().max() < 1e-5
        assert (ours.depth - theirs.depth).abs().max() < 5e-6
        assert torch.equal(ours.coverage, theirs.coverage)

    def test_grey_is_the_largest_channel(self, tmp_path, monkeypatch):
        """Value of HSV times shading, point by point: of green below, of red above."""

        def two_tone(points, normals):
            return np.where(points[:, 1:2] > 0, np.float32([0.9, 0.1, 0.3]), np.float32([0.1, 0.5, 0.2]))

        part, reference = part_and_reference(tmp_path, two_tone, monkeypatch)
        view = View(0, 0)
        shading, seen = bridge.render(part, [view]).grey[0, 0].numpy(), reference.render([view])
        grey, colour = seen.grey[0, 0].numpy(), reference.render_colour([view])[0]
        upper, lower = np.s_[20:44, 20:76], np.s_[52:76, 20:76]  # the middle rows are blurred by the fine triangles
        for rows, value in ((upper, 0.9), (lower, 0.5)):
            np.testing.assert_allclose(grey[rows], value * shading[rows], atol=2e-6)
        np.testing.assert_allclose(colour[upper], shading[upper][..., None] * [0.9, 0.1, 0.3], atol=1e-5)
        np.testing.assert_allclose(colour[lower], shading[lower][..., None] * [0.1, 0.5, 0.2], atol=1e-5)
        np.testing.assert_array_equal(reference.render([view]).grey, seen.grey)  # rendering colours leaves no trace

    def test_albedo_is_asked_at_points_with_their_normals(self, tmp_path, monkeypatch):
        asked = []

        def albedo(points, normals):
            asked.append((points, normals))
            return plain((1, 1, 1))(points, normals)

        part_and_reference(tmp_path, albedo, monkeypatch)
        ((points, normals),) = asked
        assert points.shape == normals.shape
        assert ((points * normals).sum(axis=1) > 0).all()

    def test_at_another_resolution(self, tmp_path, monkeypatch):
        _, reference = part_and_reference(tmp_path, plain((0.2, 0.7, 0.4)), monkeypatch)
        small = target.load_reference(scene.find("default"), tmp_path, RenderSettings(0.95, resolution=48, samples=64))
        fine, coarse = reference.render(VIEWS, samples=64).grey, small.render(VIEWS).grey
        assert coarse.shape[-1] == 48
        assert (torch.nn.functional.avg_pool2d(fine, 2) - coarse).abs().mean() < 2e-3
        assert small.views == reference.views == reference.scene.views


class TestPicture:
    @pytest.mark.parametrize(
        ("name", "mode"), [("a.png", "RGBA"), ("a.png", "RGB"), ("a.bmp", "RGB"), ("a@b.png", "RGBA")]
    )
    def test_read(self, tmp_path, name, mode):
        """By its transparency, or by the colour of its corners."""
        read = target.read_picture(f"{picture(tmp_path / name, (60, 40), (10, 5, 30, 35), mode=mode)}@30,-12.5")
        assert read.view == View(30, -12.5)
        assert read.rgba.shape == (40, 60, 4)
        expected = np.zeros((40, 60))
        expected[5:35, 10:30] = 1
        np.testing.assert_array_equal(read.rgba[..., 3], expected)
        np.testing.assert_allclose(read.rgba[20, 12, :3], to_linear(np.array([255, 20, 20]) / 255), rtol=1e-5)
        np.testing.assert_allclose(read.rgba[20, 27, :3], to_linear(np.full(3, 128) / 255), rtol=1e-5)

    @pytest.mark.parametrize("angles", ["", "@", "@30", "@a,b", "@1,2,3", "@30;20", "@nan,0", "@0,95"])
    def test_how_to_write_one(self, tmp_path, angles):
        path = picture(tmp_path / "a.png", (60, 40), (10, 5, 30, 35))
        with pytest.raises(ConfigError, match="azimuth,elevation"):
            target.read_picture(f"{path}{angles}")

    def test_what_cannot_be_read(self, tmp_path):
        (tmp_path / "text.png").write_text("no picture")
        (tmp_path / "empty.png").touch()
        cut = picture(tmp_path / "cut.png", (600, 400), (10, 5, 30, 35))
        cut.write_bytes(cut.read_bytes()[:200])
        for name in ("text.png", "empty.png", "nowhere.png", "cut.png", ""):
            with pytest.raises(AssetError, match="cannot read"):
                target.read_picture(f"{tmp_path / name}@0,0")

    def test_nothing_in_it(self, tmp_path):
        Image.new("RGB", (50, 50), (30, 30, 30)).save(tmp_path / "flat.png")
        Image.new("RGBA", (50, 50), (200, 30, 30, 0)).save(tmp_path / "clear.png")
        Image.new("RGBA", (50, 50), (200, 30, 30, 90)).save(tmp_path / "faint.png")
        for name in ("flat.png", "clear.png", "faint.png"):
            with pytest.raises(AssetError, match="empty"):
                target.read_picture(f"{tmp_path / name}@0,0")

    def test_fitted_to_the_outline(self, tmp_path):
        """The picture's object, wherever it is and however large, fills the bounding box of the mask."""
        read = target.read_picture(f"{picture(tmp_path / 'a.png', (200, 150), (30, 20, 110, 120))}@0,0")
        mask = np.zeros((64, 64))
        mask[12:52, 20:52] = 1
        fitted = read.fitted(mask)
        assert fitted.shape == (64, 64, 4)
        np.testing.assert_allclose(fitted[..., 3], mask, atol=0.02)
        np.testing.assert_allclose(fitted[13:51, 21:35, :3] - to_linear(np.array([255, 20, 20]) / 255), 0, atol=0.02)
        np.testing.assert_allclose(fitted[13:51, 37:51, :3], to_linear(np.array(128 / 255)), atol=0.02)


class TestReferenceFromPictures:
    def test_replaces_the_object_in_its_view_only(self, tmp_path, monkeypatch):
        pictured = target.read_picture(f"{picture(tmp_path / 'a.png', (200, 150), (30, 20, 110, 120))}@10,20")
        part, reference = part_and_reference(tmp_path, plain((1, 1, 1)), monkeypatch, pictures=(pictured,))
        assert reference.views == (View(10, 20),)
        seen, shading = reference.render(VIEWS, seed=2), bridge.render(part, VIEWS, seed=2)
        assert (seen.grey[1] - shading.grey[1]).abs().max() < 5e-6
        inside = seen.coverage[0, 0] == 1
        assert set(np.round(seen.grey[0, 0][inside & (torch.arange(96) < 40)].numpy(), 2)) == {1.0}
        right = seen.grey[0, 0][inside & (torch.arange(96) > 56)]
        np.testing.assert_allclose(right, to_linear(np.array(128 / 255)), atol=0.02)
        assert (seen.grey[0, 0][shading.coverage[0, 0] == 0] == 0).all()
        colour = reference.render_colour(VIEWS[:1])[0]
        np.testing.assert_allclose(colour[48, 30], to_linear(np.array([255, 20, 20]) / 255), atol=0.02)

    def test_beyond_the_outline_of_the_picture_nothing_is_compared(self, tmp_path, monkeypatch):
        """A diamond in the bounding box of a ball: what is background in the picture is no colour of the object."""
        y, x = np.mgrid[:80, :80] - 39.5
        pixels = np.where((np.abs(x) + np.abs(y) < 38)[..., None], (255, 255, 255, 255), (0, 0, 0, 0)).astype(np.uint8)
        Image.fromarray(pixels).save(tmp_path / "diamond.png")
        read = target.read_picture(f"{tmp_path / 'diamond.png'}@10,20")
        part, reference = part_and_reference(tmp_path, plain((1, 1, 1)), monkeypatch, pictures=(read,))
        seen, whole = reference.render(VIEWS[:1]), bridge.render(part, VIEWS[:1]).coverage
        assert 0.5 < seen.coverage.sum() / whole.sum() < 0.8
        assert (seen.coverage <= whole + 1e-6).all()
        np.testing.assert_allclose(seen.grey, seen.coverage, atol=0.02)

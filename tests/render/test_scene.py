"""Loaded scenes: their cameras, lights and materials."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

from genmf_mi.core.errors import SceneError
from genmf_mi.render import bridge, scene, variant
from genmf_mi.render.scene import View
from genmf_mi.render.view import project

BUNDLED = [path for path in sorted(scene.find("default").parent.glob("[a-z]*.xml")) if "_sdf" not in path.stem]


@pytest.fixture(scope="module")
def ball(tmp_path_factory) -> Path:
    """A ball of radius 0.95 as a PLY file."""
    variant.use("cpu")
    mesh = trimesh.creation.icosphere(3)
    path = tmp_path_factory.mktemp("ball") / "ball.ply"
    bridge.write_ply(path, 0.95 * mesh.vertices, mesh.faces)
    return path


@pytest.fixture(scope="module")
def loaded(ball) -> scene.Scene:
    return scene.load(scene.find("default"), ball, radius=0.95, resolution=64, samples=16)


DEFAULT = scene.standalone_xml("default", "mesh.ply")
MATERIAL = DEFAULT[DEFAULT.index("        <bsdf") : DEFAULT.index("        </bsdf>") + len("        </bsdf>\n")]


def position(azimuth: float, elevation: float) -> np.ndarray:
    a, e = np.radians([azimuth, elevation])
    return np.array([np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)])


class TestView:
    @pytest.mark.parametrize(("azimuth", "elevation"), [(0, 0), (90, 0), (37, 20), (200, -60), (-30, 80), (10, 90)])
    def test_camera(self, azimuth, elevation):
        """On the sphere, looking at the origin, upright, with x to the left and z forward: a rotation."""
        matrix = scene.camera_to_world(View(azimuth, elevation), 3.0)
        np.testing.assert_allclose(matrix[:3, 3], 3 * position(azimuth, elevation), atol=1e-12)
        np.testing.assert_allclose(matrix[:3, 2], -position(azimuth, elevation), atol=1e-12)
        np.testing.assert_allclose(matrix[:3, :3].T @ matrix[:3, :3], np.eye(3), atol=1e-12)
        assert np.linalg.det(matrix[:3, :3]) == pytest.approx(1)
        assert matrix[1, 0] == pytest.approx(0, abs=1e-12)
        assert matrix[1, 1] >= -1e-12

    def test_azimuth_90_looks_at_the_x_side(self):
        np.testing.assert_allclose(scene.camera_to_world(View(90, 0), 2.0)[:3, 3], [2, 0, 0], atol=1e-12)

    def test_facing(self):
        for azimuth, elevation in ((0, 0), (90, 0), (37, 20), (200, -60)):
            view = View.facing(position(azimuth, elevation))
            np.testing.assert_allclose(position(view.azimuth, view.elevation), position(azimuth, elevation), atol=1e-9)

    def test_label(self):
        assert View(30, -10.5).label == "azimuth 30°, elevation -10.5°"


@pytest.mark.parametrize("path", BUNDLED, ids=lambda path: path.stem)
class TestBundledFiles:
    def test_loads_with_its_views(self, path, ball):
        part = scene.load(path, ball, radius=0.95)
        assert len(part.views) == len(set(part.views)) == 6
        assert (part.resolution, part.sensor.sampler().sample_count()) == (384, 4)
        assert type(part.bsdf).__name__ == "TwoLight"
        assert part.integrator.aovs

    def test_own_camera_is_that_of_a_view(self, path, ball):
        """What the file shows in plain Mitsuba is what `View` means by the same angles."""
        import mitsuba as mi

        plain = mi.load_file(str(path), mesh=str(ball), azimuth="50", elevation="-15", distance="3.5")
        matrix = np.array(plain.sensors()[0].world_transform().matrix).reshape(4, 4)
        np.testing.assert_allclose(matrix, scene.camera_to_world(View(50, -15), 3.5), atol=1e-6)


class TestLoaded:
    def test_the_ball_fills_the_frame(self, loaded):
        """Its silhouette is 1/MARGIN of the frame, from every side."""
        seen = bridge.render(loaded, [View(0, 0), View(77, -40)]).coverage[:, 0].numpy()
        for mask in seen:
            assert mask[[0, -1]].max() == mask[:, [0, -1]].max() == 0
            assert (mask > 0.5).any(axis=0).sum() == pytest.approx(64 / scene.MARGIN, abs=1.5)
            assert (mask > 0.5).any(axis=1).sum() == pytest.approx(64 / scene.MARGIN, abs=1.5)

    def test_views_move_the_camera(self, loaded):
        """Depth and normal in the middle of the picture, for several views in a row."""
        views = [View(0, 0), View(90, 30), View(215, -50), View(0, 0)]
        seen = bridge.render(loaded, views)
        for i, view in enumerate(views):
            middle = slice(30, 34)
            assert seen.depth[i, 0, middle, middle].mean().item() == pytest.approx(loaded.distance - 0.95, abs=0.02)
            normal = seen.normal[i, :, middle, middle].mean(dim=(1, 2)).numpy()
            np.testing.assert_allclose(normal, position(view.azimuth, view.elevation), atol=0.01)

    def test_lights_travel_with_the_camera(self, loaded):
        """A ball looks the same from everywhere, except for its facets."""
        seen = bridge.render(loaded, [View(0, 0), View(120, 35)]).grey
        assert (seen[0] - seen[1]).abs().max() < 0.15
        assert (seen[0] - seen[1]).abs().mean() < 0.01
        assert seen[0, 0].argmax() // 64 < 32  # the key light comes from above

    def test_turned_lights(self, loaded):
        """By 30° to the right and 10° up, about the camera's axes; the next view has them back."""
        before = {key: np.ravel(loaded.params[key]) for key in variant.light_direction_keys(loaded.shape_id)}
        loaded.set_view(View(70, 20, (30.0, 0.0)))
        for key, light in before.items():
            x, y, z = light
            s, c = np.sin(np.pi / 6), np.cos(np.pi / 6)
            np.testing.assert_allclose(np.ravel(loaded.params[key]), [c * x + s * z, y, c * z - s * x], atol=1e-6)
        loaded.set_view(View(70, 20, (0.0, 90.0)))
        for key, light in before.items():
            x, y, z = light
            np.testing.assert_allclose(np.ravel(loaded.params[key]), [x, -z, y], atol=1e-6)
        loaded.set_view(View(70, 20))
        for key, light in before.items():
            np.testing.assert_allclose(np.ravel(loaded.params[key]), light, atol=1e-6)

    def test_light_from_the_right_brightens_the_right(self, loaded):
        """The key light stands in front: turning it by +60° brings it to the right."""
        seen = bridge.render(loaded, [View(0, 0, (60.0, 0.0)), View(0, 0, (-60.0, 0.0))]).grey[:, 0]
        left, right = seen[:, :, :32].sum(dim=(1, 2)), seen[:, :, 32:].sum(dim=(1, 2))
        assert right[0] > 1.2 * left[0] and left[1] > 1.2 * right[1]

    def test_distance_follows_the_radius(self, ball, loaded):
        assert scene.load(scene.find("default"), ball, radius=1.9).distance == pytest.approx(2 * loaded.distance)

    def test_material(self, ball, tmp_path):
        """Every parameter of the file, not the plugin's default; a turn of the lights does not show."""
        text = MATERIAL.replace("0.8", "0.6").replace('"0.2"', '"0.1"').replace('"8"', '"5"').replace("camera", "world")
        weights = '<float name="key_weight" value="0.5"/><float name="fill_weight" value="0.375"/></bsdf>'
        path = tmp_path / "my.xml"
        fill = DEFAULT.replace('value="0.8, 0.1, 0.6"', 'value="0.6, 0.1, 0.6"')
        path.write_text(fill.replace(MATERIAL, text.replace("</bsdf>", weights)))
        mine = scene.load(path, ball, radius=0.95)
        mine.set_view(View(0, 0, (20.0, 10.0)))
        assert mine.material == {
            "albedo": pytest.approx(0.6), "ambient": pytest.approx(0.1), "sharpness": 5, "key_weight": 0.5,
            "fill_weight": 0.375, "key": pytest.approx([-0.4, 0.5, 1]), "fill": pytest.approx([0.6, 0.1, 0.6]),
            "lights": "world"}  # fmt: skip

    def test_attribute(self, ball, tmp_path):
        mesh = trimesh.load(ball, process=False)
        dark = np.full(len(mesh.vertices), 0.25)
        bridge.write_ply(tmp_path / "dark.ply", mesh.vertices, mesh.faces, attributes={"vertex_albedo": dark})
        options = {"radius": 0.95, "resolution": 32}
        plain = scene.load(scene.find("default"), tmp_path / "dark.ply", **options)
        multiplied = scene.load(scene.find("default"), tmp_path / "dark.ply", attribute="vertex_albedo", **options)
        first, second = (bridge.render(s, [View(0, 0)]).grey for s in (plain, multiplied))
        np.testing.assert_allclose(second, 0.25 * first, atol=1e-6)


def test_views_as_text():
    assert scene.parse_views(" 0:20  -60.5:10\n") == (View(0, 20), View(-60.5, 10))


@pytest.mark.parametrize("text", ["", "   ", "0", "0:20:5", "a:b", "nan:0", "0:inf", "0:91", "0,20"])
def test_bad_views(text):
    with pytest.raises(SceneError, match="here"):
        scene.parse_views(text, "here")


@pytest.fixture(scope="module")
def bumpy(tmp_path_factory) -> Path:
    ball = trimesh.creation.icosphere(5)
    path = tmp_path_factory.mktemp("bumpy") / "bumpy.ply"
    waves = np.sin(20 * ball.vertices).prod(axis=1, keepdims=True)
    bridge.write_ply(path, 0.9 * ball.vertices * (1 + 0.03 * waves), ball.faces)
    return path


class TestZoom:
    """A magnified view is a window of a larger image."""

    VIEW, CENTRE = View(30, 10), (0.125, -0.0625)

    def test_window(self, bumpy):
        large = scene.load(scene.find("default"), bumpy, radius=1.0, resolution=256, samples=64)
        small = scene.load(scene.find("default"), bumpy, radius=1.0, resolution=64, samples=64)
        close = replace(self.VIEW, zoom=4.0, centre=self.CENTRE)
        whole, window = (bridge.render(s, [v]).grey[0, 0] for s, v in ((large, self.VIEW), (small, close)))
        left, top = (round((0.5 + c) * 256) - 32 for c in self.CENTRE)
        np.testing.assert_allclose(window, whole[top : top + 64, left : left + 64], atol=1e-3)
        np.testing.assert_array_equal(
            bridge.render(small, [self.VIEW]).grey,
            bridge.render(scene.load(scene.find("default"), bumpy, radius=1.0, resolution=64, samples=64), [self.VIEW])
            .grey,
        )  # fmt: skip

    def test_resize(self, bumpy):
        resized = scene.load(scene.find("default"), bumpy, radius=1.0, resolution=64, samples=4)
        resized.resize(96)
        fresh = scene.load(scene.find("default"), bumpy, radius=1.0, resolution=96, samples=4)
        np.testing.assert_array_equal(*(bridge.render(s, [self.VIEW]).grey for s in (resized, fresh)))
        assert resized.resolution == 96

    def test_project(self, bumpy):
        """The highest point of what is seen of a small ball beside the middle appears where it is projected to."""
        loaded = scene.load(scene.find("default"), bumpy, radius=1.0, resolution=200, samples=16)
        point = np.array([[0.3, -0.2, 0.1]])
        ball = trimesh.creation.icosphere(2)
        vertices = torch.as_tensor(point + 0.02 * ball.vertices, dtype=torch.float32)
        faces = torch.as_tensor(np.array(ball.faces))
        coverage = bridge.render(loaded, [self.VIEW], vertices, faces).coverage[0, 0].numpy()
        rows, columns = np.nonzero(coverage > 0.5)
        seen = np.array([columns.mean(), rows.mean()]) + 0.5
        expected = project(point, self.VIEW, loaded.distance, loaded.half_width)[0]
        np.testing.assert_allclose(seen / 200 - 0.5, expected, atol=0.003)

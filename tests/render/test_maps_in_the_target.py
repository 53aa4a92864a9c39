"""What normal, occlusion and emissive maps make of the target: against real bumps, and in numbers."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from bumpy_ball import ball, height, mapped
from reference_pictures import ball as icosphere

from genmf_mi.assets import asset
from genmf_mi.assets.maps import Look
from genmf_mi.render import bridge, scene, target, variant
from genmf_mi.render.scene import RenderSettings, View

VIEWS = (View(10, 20), View(200, -30))
SCALE = 0.9
"""Of the unit ball in the normalised frame."""


def white(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    return np.ones((len(points), 3), np.float32)


@pytest.fixture(scope="module")
def shown(tmp_path_factory):
    """Renders a reference of a ball without texture, by the look of its maps."""
    variant.use("cpu")
    folder = tmp_path_factory.mktemp("reference")
    vertices, faces = icosphere(6)
    vertices = vertices * (SCALE / np.linalg.norm(vertices, axis=1, keepdims=True))
    normals = bridge.write_ply(folder / "part.ply", vertices, faces)
    settings = RenderSettings(radius=0.95, resolution=96, samples=16)

    def render(look: target.MapLook | None, albedo: target.Albedo = white) -> target.Reference:
        return target.build_reference(
            scene.find("default"), folder, vertices, faces, normals, albedo, settings, look=look
        )

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(target, "FINEST", len(faces))
        yield render


class TestNormalMap:
    def test_looks_like_the_same_bumps_in_the_geometry(self, shown, tmp_path):
        """The oracle: a ball with real bumps. Those of 2 % of the radius move what is seen by a pixel at most, and hide
        nothing behind each other away from the outline."""
        found = asset.load(mapped(tmp_path / "ball.glb"))
        pretended = shown(lambda points, normals, spacing: found.look(points / SCALE, normals, spacing / SCALE))
        vertices, faces, theta, phi = ball(384)
        bridge.write_ply(tmp_path / "real.ply", SCALE * vertices * (1 + height(theta, phi))[:, None], faces)
        real = scene.load(scene.find("default"), tmp_path / "real.ply", radius=0.95, resolution=96, samples=16)
        plain = shown(None).render(VIEWS)
        oracle, ours = bridge.render(real, VIEWS), pretended.render(VIEWS)
        inside = torch.nn.functional.avg_pool2d(plain.coverage, 9, 1, 4) > 0.999
        error, bumps = ((x.grey - oracle.grey).abs()[inside] for x in (ours, plain))
        assert bumps.mean() > 0.01
        assert error.mean() < 0.0025
        tilted, flat = (
            (x.normal - oracle.normal).abs().mean(dim=1, keepdim=True)[inside].mean() for x in (ours, plain)
        )
        assert tilted < 0.005 and flat > 0.03
        assert torch.equal(ours.depth, plain.depth), "the map moves nothing"

    def test_a_flat_one_changes_no_bit(self, shown):
        def flat(points, normals, spacing):
            return Look(np.array(normals, dtype=np.float64), np.ones(len(points)), np.zeros((len(points), 3)))

        assert torch.equal(shown(flat).render(VIEWS).grey, shown(None).render(VIEWS).grey)


class TestLight:
    def of(self, shown, occlusion: float, emission: tuple[float, float, float], rgb: tuple[float, float, float]):
        def look(points, normals, spacing):
            count = len(points)
            return Look(np.array(normals), np.full(count, occlusion), np.tile(np.float32(emission), (count, 1)))

        return shown(look, lambda points, normals: np.tile(np.float32(rgb), (len(points), 1)))

    def test_occlusion_takes_ambient_light_alone(self, shown):
        plain, reference = shown(None), self.of(shown, 0.25, (0, 0, 0), (1, 1, 1))
        material = plain.scene.material
        expected = plain.render(VIEWS).grey - 0.75 * material["ambient"] * material["albedo"] * (
            plain.render(VIEWS).coverage
        )
        assert (reference.render(VIEWS).grey - expected).abs().max() < 1e-6

    def test_emission_adds_in_each_channel_up_to_white(self, shown):
        reference = self.of(shown, 1.0, (0.0, 0.3, 4.0), (0.5, 0.1, 0.2))
        lit = shown(None).render(VIEWS)
        white = shown(None).scene.material["albedo"]
        shading, coverage = lit.grey[:, 0].numpy(), lit.coverage[:, 0].numpy()
        inside = coverage > 0.999
        colour = reference.render_colour(VIEWS)
        channels = [0.5 * shading, 0.1 * shading + 0.3 * white, np.full_like(shading, white)]
        for i, expected in enumerate(channels):
            np.testing.assert_allclose(colour[..., i][inside], expected[inside], atol=1e-5)
        np.testing.assert_allclose(reference.render(VIEWS).grey[:, 0].numpy()[inside], white, atol=1e-5)

    def test_which_channel_is_brightest_depends_on_the_light(self, shown):
        reference = self.of(shown, 1.0, (0.0, 0.0, 0.6), (1.0, 0.0, 0.0))
        plain = shown(None)
        shading, white = plain.render(VIEWS).grey, plain.scene.material["albedo"]
        inside = plain.render(VIEWS).coverage > 0.999
        expected = shading.clamp_min(0.6 * white)
        grey = reference.render(VIEWS).grey
        assert (shading[inside] < 0.6 * white).any() and (shading[inside] > 0.6 * white).any()
        assert (grey - expected)[inside].abs().max() < 0.01

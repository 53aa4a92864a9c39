"""Scenes around Φ: the same picture as the extracted mesh gives; what Mitsuba's derivatives of ``sdfgrid`` are."""

from __future__ import annotations

import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.ndimage import binary_erosion, map_coordinates
from torch.nn.functional import normalize

from genmf_mi.assets.sdf_asset import SdfAsset
from genmf_mi.core.errors import OutputError, SceneError
from genmf_mi.core.frame import Frame
from genmf_mi.render import bridge, scene, sdf_scene, variant
from genmf_mi.render.scene import GRID, View

CENTRE, HALF = (5.0, 6.0, 7.0), 3.0
VIEWS = (View(0, 20), View(110, -30), View(215, 60))


def blob(m: int = 65) -> np.ndarray:
    """Φ ``[m,m,m]`` of a ball with one bump each to the right, above and in front, of different sizes, off the middle;
    the four are blended, so that the normal has no jumps."""
    ticks = np.linspace(-1, 1, m)
    p = np.stack(np.meshgrid(ticks, ticks, ticks, indexing="ij"), axis=-1) - (0.1, -0.15, 0.05)
    balls = (((0, 0, 0), 0.4), ((0.45, 0, 0), 0.2), ((0, 0.5, 0.1), 0.25), ((-0.1, 0.1, 0.45), 0.15))
    distances = [np.linalg.norm(p - np.array(c), axis=-1) - r for c, r in balls]
    return (-np.log(sum(np.exp(-d / 0.05) for d in distances)) * 0.05).astype(np.float32)


def shown_as_both(folder: Path, m: int) -> SimpleNamespace:
    """The blob on a grid of ``m`` samples, as a mesh and as that grid."""
    variant.use("cpu")
    shape = SdfAsset("blob", blob(m), centre=CENTRE, half=HALF)
    vertices, faces = shape.surface()
    frame = Frame.of(vertices, size_mm=1.0)
    vertices = frame.normalise(vertices)
    bridge.write_ply(folder / "blob.ply", vertices, faces)
    options = {"radius": float(np.linalg.norm(vertices, axis=1).max()), "resolution": 128, "samples": 16}
    grid = sdf_scene.write_grid(shape, folder / "blob.vol")
    part = sdf_scene.load(scene.find("strawberry", GRID), grid, shape, frame, **options)
    mesh = scene.load(scene.find("strawberry"), folder / "blob.ply", **options)
    return SimpleNamespace(shape=shape, frame=frame, grid=grid, options=options,
                           seen=bridge.render(mesh, VIEWS), found=bridge.render(part, VIEWS))  # fmt: skip


@pytest.fixture(scope="module")
def shown(tmp_path_factory) -> SimpleNamespace:
    return shown_as_both(tmp_path_factory.mktemp("blob"), 65)


def disagreement(shown: SimpleNamespace) -> dict[str, float]:
    """Mean differences: of coverage everywhere, of the others (the normal in degrees) where pixels are full."""
    seen, found = shown.seen, shown.found
    inner = np.stack([binary_erosion(mask > 0.999, iterations=2) for mask in seen.coverage[:, 0].numpy()])[:, None]
    assert inner.sum() > 10_000
    assert (found.coverage[inner] > 0.999).all(), "rays slip through"
    cosine = (normalize(seen.normal) * normalize(found.normal)).sum(dim=1, keepdim=True)[inner]
    return {
        "coverage": float((seen.coverage - found.coverage).abs().mean()),
        "depth": float((seen.depth - found.depth).abs()[inner].mean()),
        "grey": float((seen.grey - found.grey).abs()[inner].mean()),
        "normal": float(np.degrees(np.arccos(cosine.clamp(-1, 1).numpy())).mean()),
    }


class TestPicture:
    def test_agrees_with_the_mesh(self, shown, tmp_path):
        """At 65 samples outlines to 0.15 % of the picture, depth to 5 % of a cell, grey to 0.004, normals to 1°; with
        half as many samples three times as much, as dual vertices lie inside of bulges by the square of a cell."""
        fine, coarse = disagreement(shown), disagreement(shown_as_both(tmp_path, 33))
        cell = 2 * shown.shape.half * shown.frame.scale / shown.shape.resolution
        assert fine["coverage"] < 1.5e-3 and fine["depth"] < 0.05 * cell
        assert fine["grey"] < 4e-3 and fine["normal"] < 1
        assert 3 * fine["coverage"] < coarse["coverage"] and 3 * fine["depth"] < coarse["depth"]

    @pytest.mark.parametrize("axes", [(2, 1, 0), (1, 0, 2), (0, 2, 1)])
    def test_any_other_order_of_the_axes_would_show(self, shown, axes, tmp_path):
        turned = SdfAsset("turned", np.ascontiguousarray(shown.shape.phi.transpose(axes)), centre=CENTRE, half=HALF)
        grid = sdf_scene.write_grid(turned, tmp_path / "turned.vol")
        part = sdf_scene.load(scene.find("default", GRID), grid, turned, shown.frame, **shown.options)
        assert (bridge.render(part, VIEWS).coverage - shown.seen.coverage).abs().mean() > 0.02

    def test_from_plain_mitsuba(self, shown):
        """The file's own camera and defaults: the grid is the cube ± 1."""
        import mitsuba as mi

        path = str(scene.find("strawberry", GRID))
        plain = mi.load_file(path, grid=str(shown.grid), azimuth="30", elevation="10", resolution="64")
        image = np.array(mi.render(plain))
        options = {"radius": 4.3 * np.sin(np.radians(14)) / scene.MARGIN, "resolution": 64, "samples": 4}
        same = sdf_scene.load(path, shown.grid, SdfAsset("blob", blob()), Frame((0, 0, 0), 1.0, 1.0), **options)
        np.testing.assert_allclose(image[..., 0], bridge.render(same, [View(30, 10)]).grey[0, 0], atol=1e-4)
        assert image[..., 5].max() == pytest.approx(1)

    def test_documented_lines(self, shown, tmp_path, monkeypatch):
        text = (Path(__file__).parents[1] / "docs" / "generators.md").read_text(encoding="utf-8")
        (lines,) = (b for b in re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL) if "mi.load_file" in b)
        monkeypatch.chdir(tmp_path)
        Path("bus.vol").write_bytes(shown.grid.read_bytes())
        names = {}
        exec(lines, names)
        assert names["image"].shape == (384, 384, 6) and np.array(names["image"])[..., 5].max() == pytest.approx(1)

    def test_a_mesh_scene_holds_no_grid(self, shown):
        with pytest.raises(SceneError, match=r'strawberry.xml has no <default name="grid" .* no grid can be put in'):
            sdf_scene.load(scene.find("strawberry"), shown.grid, shown.shape, shown.frame, radius=1.0)
        with pytest.raises(SceneError, match=r'strawberry_sdf.xml has no <default name="mesh"'):
            scene.load(scene.find("strawberry", GRID), shown.grid, radius=1.0)

    def test_no_space(self, shown, full_disk, tmp_path):
        with pytest.raises(OutputError, match=r"blob\.vol"), full_disk():
            sdf_scene.write_grid(shown.shape, tmp_path / "blob.vol")
        assert not list(tmp_path.iterdir())


def ellipsoid(m: int, radii: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Φ ``[z,y,x]`` on the unit cube, of slope about one at the surface and exactly one for a ball; and a direction to
    change it in."""
    ticks = np.linspace(0, 1, m)
    z, y, x = np.meshgrid(ticks, ticks, ticks, indexing="ij")
    phi = 0.3 * (np.sqrt(sum(((c - 0.5) / r) ** 2 for c, r in zip((x, y, z), radii, strict=True))) - 1)
    return phi, np.sin(5 * x + 1) * np.cos(4 * y) * np.ones_like(z)


SIDE = 192


class Fixed:
    """A fixed bundle of rays at a grid that changes."""

    def __init__(self, phi: np.ndarray, normals: str) -> None:
        import mitsuba as mi

        variant.use("cpu")
        film = {"type": "hdrfilm", "width": SIDE, "height": SIDE, "pixel_format": "luminance"}
        look = mi.ScalarTransform4f().look_at([0.5, 0.6, 3], [0.5, 0.5, 0.5], [0, 1, 0])
        self.scene = mi.load_dict({
            "type": "scene",
            "integrator": {"type": "monochrome"},
            "camera": {"type": "perspective", "id": "camera", "fov": 12, "to_world": look, "film": film},
            "object": {"type": "sdfgrid", "grid": mi.TensorXf(phi[..., None]), "normals": normals,
                       "bsdf": {"type": "twolight", "id": "material"}},
        })  # fmt: skip
        self.params, self.integrator, sensor = mi.traverse(self.scene), self.scene.integrator(), self.scene.sensors()[0]
        self.integrator.aim(self.scene, sensor)
        x, y = np.meshgrid(*[(np.arange(SIDE, dtype=np.float32) + 0.5) / SIDE] * 2)
        self.ray, _ = sensor.sample_ray(0, 0, mi.Point2f(x.ravel(), y.ravel()), mi.Point2f(0))

    def look(self, grid):
        """Grey and depth along the ray, ``[SIDE²]`` each; past the refusal of whole images."""
        import drjit as dr
        import mitsuba as mi

        self.params["object.grid"] = grid
        self.params.update()
        grey, valid, *_ = self.integrator.sample(dr.ADMode.Backward, self.scene, None, self.ray)
        grey, t = dr.ravel(grey), dr.select(valid, self.scene.ray_intersect(self.ray, mi.RayFlags.All, True).t, 0)
        dr.eval(grey, t)
        dr.sync_thread()  # before the grid changes again
        return grey, t

    def differences(self, phi: np.ndarray, along: np.ndarray, step: float) -> list[np.ndarray]:
        import mitsuba as mi

        up, down = (self.look(mi.TensorXf((phi + h * along)[..., None])) for h in (step, -step))
        return [(np.array(a, dtype=float) - np.array(b, dtype=float)) / (2 * step) for a, b in zip(up, down)]

    def derivatives(self, phi: np.ndarray, along: np.ndarray) -> list[np.ndarray]:
        """The same by Mitsuba in forward mode."""
        import drjit as dr
        import mitsuba as mi

        found = []
        for index in range(2):
            amount = mi.Float(0)
            dr.enable_grad(amount)
            seen = self.look(mi.TensorXf(phi[..., None]) + mi.TensorXf(along[..., None]) * amount)[index]
            dr.forward(amount)
            found.append(np.array(dr.grad(seen), dtype=float))
        return found

    def inner(self, phi: np.ndarray) -> np.ndarray:
        """Rays away from the outline: where it moves, no derivative is claimed."""
        import mitsuba as mi

        hit = np.array(self.look(mi.TensorXf(phi[..., None]))[1]).reshape(SIDE, SIDE) > 0
        return binary_erosion(hit, iterations=6).ravel()


WEIGHTS = np.tile(np.cos(7 * np.arange(SIDE) / SIDE), SIDE)
"""Of the rays in a sum, lest what is wrong on the left cancel what is wrong on the right."""


class TestDerivatives:
    """What ``sdf_scene`` says about Mitsuba. Should one of these fail with another version: see whether the gradient
    is right by then, and if it is, drop the refusal in ``monochrome``."""

    @pytest.mark.parametrize("slope", [1.0, 2.0])
    def test_depth_moves_too_far_by_the_slope(self, slope):
        """Ray by ray on an ellipsoid, whose slope differs from place to place."""
        import mitsuba as mi

        m = 17
        phi, along = (slope * array for array in ellipsoid(m, (0.3, 0.25, 0.35)))
        fixed = Fixed(phi, "smooth")
        expected, found = fixed.differences(phi, along, 1e-3)[1], fixed.derivatives(phi, along)[1]
        t = np.array(fixed.look(mi.TensorXf(phi[..., None]))[1], dtype=float)
        points = np.array(fixed.ray.o + fixed.ray.d * mi.Float(t), dtype=float)
        step, value = 1e-5, lambda p: map_coordinates(phi, (p * (m - 1))[::-1], order=1)
        gradient = [(value(points + e) - value(points - e)) / (2 * step) for e in step * np.eye(3)[:, :, None]]
        size = np.linalg.norm(gradient, axis=0)
        chosen = fixed.inner(phi) & (np.abs(expected) > 0.05)
        assert chosen.sum() > 10_000
        ratio = found[chosen] / expected[chosen]
        assert np.median(ratio / size[chosen]) == pytest.approx(1, abs=1e-3)
        assert np.percentile(np.abs(ratio / size[chosen] - 1), 95) < 0.02
        assert np.median(ratio) == pytest.approx(0.93 * slope, abs=0.03 * slope)

    @pytest.mark.parametrize(
        ("normals", "slope", "low", "high"),
        [("smooth", 1.0, 0.995, 1.005), ("smooth", 2.0, 2.0, 2.5), ("analytic", 1.0, 0.2, 0.4)],
    )
    def test_grey_values_of_a_ball(self, normals, slope, low, high):
        """Mitsuba's derivative over the finite difference, which three steps agree on."""
        phi, along = (slope * array for array in ellipsoid(65, (0.3, 0.3, 0.3)))
        fixed = Fixed(phi, normals)
        weights = WEIGHTS * fixed.inner(phi)
        expected = [weights @ fixed.differences(phi, along, step)[0] for step in (4e-3, 2e-3, 1e-3)]
        assert np.ptp(expected) < (0.005 if normals == "smooth" else 0.1) * abs(expected[1])
        assert low < weights @ fixed.derivatives(phi, along)[0] / expected[1] < high

    def test_are_refused(self):
        """Of the grid, by every way to ask for them; those of the material stay."""
        import drjit as dr
        import mitsuba as mi

        phi, _ = ellipsoid(9, (0.3, 0.3, 0.3))
        fixed = Fixed(phi, "smooth")
        grid = mi.TensorXf(phi[..., None])
        dr.enable_grad(grid)
        fixed.params["object.grid"] = grid
        fixed.params.update()
        with pytest.raises(Exception, match=r"its grid are wrong\. Take them through genmf_mi\.geometry\.flexicubes"):
            fixed.integrator.render_attached(fixed.scene, fixed.scene.sensors()[0])
        image = mi.render(fixed.scene, fixed.params, spp=1)
        with pytest.raises(Exception, match="its grid are wrong"):
            dr.backward(dr.sum(image, axis=None))
        dr.sync_thread()
        fixed.params["object.grid"] = mi.TensorXf(phi[..., None])
        albedo = mi.Float(0.8)
        dr.enable_grad(albedo)
        fixed.params["object.bsdf.albedo.value"] = albedo
        fixed.params.update()
        dr.backward(dr.sum(mi.render(fixed.scene, fixed.params, spp=1), axis=None))
        assert dr.grad(albedo)[0] > 0


@pytest.mark.parametrize("name", ["strawberry", "strawberry_sdf", "nothing_bundled"])
def test_found_by_the_name_of_the_sample(name):
    stem = "default" if "bundled" in name else "strawberry"
    assert scene.find(name) == scene.find("default").with_name(f"{stem}.xml")
    assert scene.find(name, GRID) == scene.find("default").with_name(f"{stem}_sdf.xml")

"""What Mitsuba's derivatives of the shape ``sdfgrid`` are, and that they are refused."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import binary_erosion, map_coordinates

from genmf_mi.render import variant


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
        to_world = mi.ScalarTransform4f().look_at([0.5, 0.6, 3], [0.5, 0.5, 0.5], [0, 1, 0])
        self.scene = mi.load_dict({
            "type": "scene",
            "integrator": {"type": "monochrome"},
            "camera": {"type": "perspective", "id": "camera", "fov": 12, "to_world": to_world, "film": film},
            "object": {"type": "sdfgrid", "grid": mi.TensorXf(phi[..., None]), "normals": normals,
                       "bsdf": {"type": "twolight", "id": "material"}},
        })  # fmt: skip
        self.params, self.integrator, sensor = mi.traverse(self.scene), self.scene.integrator(), self.scene.sensors()[0]
        self.integrator.aim(self.scene, sensor)
        x, y = np.meshgrid(*[(np.arange(SIDE, dtype=np.float32) + 0.5) / SIDE] * 2)
        self.ray, _ = sensor.sample_ray(0, 0, mi.Point2f(x.ravel(), y.ravel()), mi.Point2f(0))

    def trace(self, grid):
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

        up, down = (self.trace(mi.TensorXf((phi + h * along)[..., None])) for h in (step, -step))
        return [(np.array(a, dtype=float) - np.array(b, dtype=float)) / (2 * step) for a, b in zip(up, down)]

    def derivatives(self, phi: np.ndarray, along: np.ndarray) -> list[np.ndarray]:
        """The same by Mitsuba in forward mode."""
        import drjit as dr
        import mitsuba as mi

        found = []
        for index in range(2):
            amount = mi.Float(0)
            dr.enable_grad(amount)
            seen = self.trace(mi.TensorXf(phi[..., None]) + mi.TensorXf(along[..., None]) * amount)[index]
            dr.forward(amount)
            found.append(np.array(dr.grad(seen), dtype=float))
        return found

    def inner(self, phi: np.ndarray) -> np.ndarray:
        """Rays away from the outline: where it moves, no derivative is claimed."""
        import mitsuba as mi

        hit = np.array(self.trace(mi.TensorXf(phi[..., None]))[1]).reshape(SIDE, SIDE) > 0
        return binary_erosion(hit, iterations=6).ravel()


WEIGHTS = np.tile(np.cos(7 * np.arange(SIDE) / SIDE), SIDE)
"""Of the rays in a sum, lest what is wrong on the left cancel what is wrong on the right."""


class TestDerivatives:
    """What the docstring of ``sdf_scene`` says about Mitsuba.

    Should one of these fail with another version, see whether the gradient is right by then, and if it is, drop the
    refusal in ``monochrome``.
    """

    @pytest.mark.parametrize("slope", [1.0, 2.0])
    def test_depth_moves_too_far_by_the_slope(self, slope):
        """Ray by ray on an ellipsoid, whose slope differs from place to place."""
        import mitsuba as mi

        m = 17
        phi, along = (slope * array for array in ellipsoid(m, (0.3, 0.25, 0.35)))
        fixed = Fixed(phi, "smooth")
        expected, found = fixed.differences(phi, along, 1e-3)[1], fixed.derivatives(phi, along)[1]
        t = np.array(fixed.trace(mi.TensorXf(phi[..., None]))[1], dtype=float)
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
        with pytest.raises(Exception, match=r"its grid are wrong\. Take them through genmf_mi\.sdf\.flexicubes"):
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

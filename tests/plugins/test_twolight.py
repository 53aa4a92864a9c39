"""The material against its formula in NumPy, under the integrator ``monochrome`` and under ordinary ones."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest
from shading import DISTANCE, FOV, PARAMETERS, ball, camera, grey, image, phi, properties, sensor


@pytest.mark.parametrize("name", ["llvm_ad_mono", "llvm_ad_rgb", "cuda_ad_mono"])
@pytest.mark.parametrize(
    "material",
    [
        {},
        {"albedo": 0.5, "ambient": 0.0, "sharpness": 2.0},
        {"key": [1, -2, 0.5], "fill": [-1, 0, 0.2], "key_weight": 0.4, "fill_weight": 0.9, "sharpness": 60.0},
    ],
)
@pytest.mark.parametrize("lights", ["camera", "world"])
def test_grey_value_is_the_formula(switch, name, material, lights):
    """With one sample per pixel the normal buffer holds the very normal that was shaded."""
    switch(name)
    seen = image(ball({**material, "lights": lights}, azimuth=130, elevation=-35), seed=3)
    hit = seen[..., -1] == 1
    axes = camera(130, -35)[1] if lights == "camera" else np.eye(3)
    oracle = {k: np.array(v) if isinstance(v, list) else v for k, v in material.items()}
    assert 0.2 < hit.mean() < 0.8
    # An RGB image repeats G in its three channels
    assert np.abs(seen[hit][:, :-5] - grey(seen[hit][:, -4:-1], axes, **oracle)[:, None]).max() < 2e-5
    assert (seen[~hit] == 0).all()


def test_attribute_multiplies_the_albedo():
    """A square whose left corners have the value 0 and whose right ones have 1."""
    mesh = mi.Mesh("square", 4, 2, props=properties({"type": "twolight", "attribute": "vertex_albedo"}))
    mesh.add_attribute("vertex_albedo", 1, [0.0, 1.0, 1.0, 0.0])
    params = mi.traverse(mesh)
    params["vertex_positions"] = np.float32([[-9, -9, 0], [9, -9, 0], [9, 9, 0], [-9, 9, 0]]).ravel()
    params["faces"] = np.uint32([[0, 1, 2], [0, 2, 3]]).ravel()
    params.update()
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "monochrome"},
            "mesh": mesh,
            "sensor": sensor(resolution=16, samples=64, sampler="stratified"),
        }
    )
    x = ((np.arange(16) + 0.5) / 8 - 1) * np.tan(np.radians(FOV / 2)) * DISTANCE
    expected = grey(np.array([0.0, 0.0, 1.0])) * (x + 9) / 18
    np.testing.assert_allclose(image(scene)[..., 0], np.broadcast_to(expected, (16, 16)), rtol=5e-3)


def test_two_materials_in_one_scene():
    def half(side: float, albedo: float) -> dict:
        return {
            "type": "rectangle",
            "material": {"type": "twolight", "albedo": albedo},
            "to_world": mi.ScalarTransform4f().translate([side * 20, 0, 0]).scale(20),
        }

    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "monochrome"},
            "left": half(-1, 0.3),
            "right": half(1, 0.9),
            "sensor": sensor(resolution=8, samples=4),
        }
    )
    seen = image(scene)[..., 0]
    front = np.array([0.0, 0.0, 1.0])
    np.testing.assert_allclose(seen[:, :4], grey(front, albedo=0.3), rtol=1e-5)
    np.testing.assert_allclose(seen[:, 4:], grey(front, albedo=0.9), rtol=1e-5)


def test_parameters_are_exposed_and_take_effect():
    scene = ball()
    params = mi.traverse(scene)
    assert {f"ball.bsdf.{name}" for name in PARAMETERS} <= set(params.keys())
    before = image(scene)
    params["ball.bsdf.key"] = mi.Vector3f(1, 2, 0.3)
    params["ball.bsdf.ambient"] = 0.5
    params.update()
    hit = before[..., 5] == 1
    expected = grey(before[hit][:, 2:5], key=np.array([1, 2, 0.3]), ambient=0.5)
    np.testing.assert_allclose(image(scene)[hit][:, 0], expected, atol=2e-5)


@pytest.mark.parametrize(
    "wrong",
    [{"lights": "sideways"}, {"ambient": 1.0}, {"ambient": -0.1}, {"sharpness": 0.0}, {"sharpness": -3.0},
     {"key": [0, 0, 0]}, {"fill": [0.0, 0.0, 0.0]}, {"shininess": 3.0}],
)  # fmt: skip
def test_bad_parameters_are_refused_by_name(wrong):
    with pytest.raises(RuntimeError, match=next(iter(wrong))):
        mi.load_dict({"type": "twolight", **wrong})


class TestAsAnOrdinaryMaterial:
    """Under any other integrator: diffuse, with φ in place of the clamped cosine."""

    @staticmethod
    def under_path(emitter: dict, samples: int):
        return mi.load_dict({
            "type": "scene", "integrator": {"type": "path", "max_depth": 2}, "emitter": emitter,
            "sensor": sensor(resolution=8, samples=samples),
            "wall": {"type": "rectangle", "material": {"type": "twolight", "albedo": 0.6, "sharpness": 4.0},
                     "to_world": mi.ScalarTransform4f().scale(20)},
        })  # fmt: skip

    @pytest.mark.parametrize("name", ["scalar_rgb", "llvm_ad_rgb", "llvm_ad_mono"])
    def test_directional_light(self, switch, name):
        switch(name)
        light = np.array([0.6, 0.0, -0.8])
        scene = self.under_path({"type": "directional", "direction": light.tolist(), "irradiance": 3.0}, 4)
        np.testing.assert_allclose(image(scene), 0.6 / np.pi * phi(0.8, 4.0) * 3.0, rtol=1e-4)

    @pytest.mark.parametrize("name", ["scalar_rgb", "llvm_ad_mono"])
    def test_constant_light(self, switch, name):
        """∫ γ φ(cos θ) / π dω over the hemisphere; emitter and material sampling are both used."""
        switch(name)
        scene = self.under_path({"type": "constant", "radiance": 1.0}, 256)
        cosines = (np.arange(10_000) + 0.5) / 10_000
        expected = 0.6 * 2 * phi(cosines, 4.0).mean()
        assert image(scene).mean() == pytest.approx(expected, rel=0.01)

    def test_sampling_agrees_with_evaluation(self):
        """The mean weight of material sampling alone is the same integral, and its densities are those of `pdf`."""
        material = mi.load_dict({"type": "twolight", "albedo": 0.6, "sharpness": 4.0})
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(0, 100_000)
        si = mi.SurfaceInteraction3f()
        si.wi, si.t = mi.Vector3f(0, 0, 1), 1.0
        drawn, weight = material.sample(mi.BSDFContext(), si, sampler.next_1d(), sampler.next_2d())
        cosines = (np.arange(10_000) + 0.5) / 10_000
        assert np.array(weight).mean() == pytest.approx(0.6 * 2 * phi(cosines, 4.0).mean(), rel=0.01)
        value, density = material.eval_pdf(mi.BSDFContext(), si, drawn.wo)
        np.testing.assert_allclose(np.array(drawn.pdf), np.array(density), rtol=1e-5)
        np.testing.assert_allclose(np.array(weight), np.array(value) / np.array(density), rtol=1e-4)

    def test_black_from_behind(self):
        material = mi.load_dict({"type": "twolight"})
        si = mi.SurfaceInteraction3f()
        si.wi = mi.Vector3f(0, 0, -1)
        assert np.array(material.eval(mi.BSDFContext(), si, mi.Vector3f(0, 0, 1))).sum() == 0
        assert np.array(material.pdf(mi.BSDFContext(), si, mi.Vector3f(0, 0, -1))).sum() == 0

"""The material and the integrator against NumPy, on shapes whose depth and normals are known in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from genmf_mi.render import variant

mi = pytest.importorskip("mitsuba")

AXES = np.eye(3)
KEY, FILL = np.array([-0.4, 0.5, 1.0]), np.array([0.8, 0.1, 0.6])
DISTANCE, FOV = 5.0, 40.0


@pytest.fixture(autouse=True)
def _mono():
    variant.use("cpu")


@pytest.fixture
def switch():
    """Any variant for one test; the usual one afterwards."""

    def to(name: str) -> None:
        if name not in mi.variants():
            pytest.skip(f"this Mitsuba has no variant {name}")
        if name.startswith("cuda") and not variant.cuda_available():
            pytest.skip("no CUDA device is visible to both torch and Dr.Jit")
        mi.set_variant(name)

    yield to
    variant.use("cpu")


def phi(x: np.ndarray, sharpness: float) -> np.ndarray:
    return np.logaddexp(0, sharpness * x) / np.logaddexp(0, sharpness)


def grey(
    normals: np.ndarray,
    axes: np.ndarray = AXES,
    *,
    albedo=0.8,
    ambient=0.2,
    key=KEY,
    fill=FILL,
    key_weight=0.75,
    fill_weight=0.25,
    sharpness=8.0,
) -> np.ndarray:
    """G as `twolight` documents it; the columns of ``axes`` are right, up and towards the viewer."""
    lit = sum(
        weight * phi(normals @ (axes @ (light / np.linalg.norm(light))), sharpness)
        for weight, light in ((key_weight, key), (fill_weight, fill))
    )
    return albedo * (ambient + (1 - ambient) * lit)


def camera(azimuth: float = 0, elevation: float = 0) -> tuple[np.ndarray, np.ndarray]:
    """Where the camera is, and the columns right, up, towards the viewer, from spherical coordinates."""
    a, e = np.radians([azimuth, elevation])
    back = np.array([np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)])
    right = np.cross([0, 1, 0], back)
    right /= np.linalg.norm(right)
    return DISTANCE * back, np.stack([right, np.cross(back, right), back], axis=1)


def transform(azimuth: float = 0, elevation: float = 0):
    origin, axes = camera(azimuth, elevation)
    return mi.ScalarTransform4f().look_at(origin=origin.tolist(), target=[0, 0, 0], up=axes[:, 1].tolist())


def sensor(azimuth: float = 0, elevation: float = 0, *, resolution=32, samples=1, sampler="independent") -> dict:
    return {
        "type": "perspective", "fov": FOV, "to_world": transform(azimuth, elevation),
        "sampler": {"type": sampler, "sample_count": samples},
        "film": {"type": "hdrfilm", "width": resolution, "height": resolution, "rfilter": {"type": "box"},
                 "pixel_format": "luminance"},
    }  # fmt: skip


def ball(material: dict | None = None, integrator: dict | None = None, **camera):
    return mi.load_dict({
        "type": "scene", "integrator": {"type": "monochrome", **(integrator or {})}, "sensor": sensor(**camera),
        "ball": {"type": "sphere", "material": {"type": "twolight", **(material or {})}},
    })  # fmt: skip


def image(scene, **options) -> np.ndarray:
    return np.array(mi.render(scene, **options), dtype=np.float64)


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


def test_buffers_of_a_sphere():
    """Sphere of radius 1 at the origin: the pixel centre's ray is known, and so are its normal and its depth."""
    azimuth, elevation, n = 40, 25, 48
    scene = ball(azimuth=azimuth, elevation=elevation, resolution=n, samples=256, sampler="stratified")
    seen = image(scene)
    origin, axes = camera(azimuth, elevation)
    x, y = np.meshgrid((np.arange(n) + 0.5) / n * 2 - 1, 1 - (np.arange(n) + 0.5) / n * 2)
    half = np.tan(np.radians(FOV / 2))
    rays = np.stack([x * half, y * half, -np.ones_like(x)], axis=-1) @ axes.T
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    along = rays @ origin
    root = along**2 - (origin @ origin - 1)
    inside = (root > 0.2) & (seen[..., 5] == 1)  # not at the rim, where the surface bends within a pixel
    points = origin + (-along - np.sqrt(np.maximum(root, 0)))[..., None] * rays
    assert inside.sum() > 100
    np.testing.assert_allclose(seen[inside][:, 2:5], points[inside], atol=0.01)
    np.testing.assert_allclose(seen[inside][:, 1], (origin - points[inside]) @ axes[:, 2], atol=0.005)


def test_planar_depth_of_a_plane_is_constant():
    """Euclidean distance would grow by 6 % towards the corners of this frame."""
    # Mitsuba's camera looks along its +z, a rectangle faces +z
    away = mi.ScalarTransform4f().translate([0, 0, DISTANCE + 1.5])
    wall = transform(60, 20) @ away.rotate([0, 1, 0], 180).scale(10)
    scene = mi.load_dict({
        "type": "scene", "integrator": {"type": "monochrome"}, "sensor": sensor(60, 20),
        "wall": {"type": "rectangle", "material": {"type": "twolight"}, "to_world": wall},
    })  # fmt: skip
    seen = image(scene)
    np.testing.assert_allclose(seen[..., 1], DISTANCE + 1.5, rtol=1e-5)
    assert (seen[..., 5] == 1).all()


def test_coverage_is_the_share_of_the_pixel():
    """The edge of a plane cuts the pixels of one column at 0.3 of their width."""
    n, column = 8, 5
    edge = ((column + 0.3) / n * 2 - 1) * np.tan(np.radians(FOV / 2)) * DISTANCE
    scene = mi.load_dict({
        "type": "scene", "integrator": {"type": "monochrome"},
        "sensor": sensor(resolution=n, samples=1024, sampler="stratified"),
        "wall": {"type": "rectangle", "material": {"type": "twolight"},
                 "to_world": mi.ScalarTransform4f().translate([edge - 20, 0, 0]).scale(20)},
    })  # fmt: skip
    seen = image(scene)
    expected = np.where(np.arange(n) < column, 1.0, np.where(np.arange(n) == column, 0.3, 0.0))
    np.testing.assert_allclose(seen[..., 5], np.broadcast_to(expected, (n, n)), atol=0.02)
    # All buffers are averages over the samples with 0 outside: dividing by the coverage gives the surface
    partly = seen[:, column]
    np.testing.assert_allclose(partly[:, 1] / partly[:, 5], DISTANCE, rtol=1e-5)
    np.testing.assert_allclose(partly[:, 4] / partly[:, 5], 1, rtol=1e-5)


def test_without_aovs_only_the_image():
    scene = ball(integrator={"aovs": False})
    assert scene.integrator().aov_names() == []
    seen = image(scene)
    assert seen.shape == (32, 32, 1)
    np.testing.assert_array_equal(seen[..., 0], image(ball())[..., 0])


def test_attribute_multiplies_the_albedo():
    """A square whose left corners have the value 0 and whose right ones have 1."""
    mesh = mi.Mesh("square", 4, 2, props=_properties({"type": "twolight", "attribute": "vertex_albedo"}))
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


def _properties(bsdf: dict):
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(bsdf)
    return properties


PARAMETERS = ("albedo.value", "ambient", "key", "fill", "key_weight", "fill_weight", "sharpness")


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


def difference(scene, params, key: str, weight: np.ndarray, step: float = 1e-2) -> float:
    """Central difference of the weighted sum of all buffers, along (1, 1, 1) where the parameter is a vector."""
    value = type(params[key])(params[key])  # a copy: assignments below change the original in place
    sums = []
    for sign in (1, -1):
        params[key] = value + sign * step
        params.update()
        sums.append((image(scene, seed=1) * weight).sum())
    params[key] = value
    params.update()
    return (sums[0] - sums[1]) / (2 * step)


@pytest.mark.parametrize("name", PARAMETERS)
def test_gradient_through_mi_render(name):
    """Mitsuba's adjoint takes other samples than the image: many of them, under smooth weights."""
    dr = pytest.importorskip("drjit")
    scene = ball(azimuth=70, elevation=10, samples=256, sampler="stratified")
    params, key = mi.traverse(scene), f"ball.bsdf.{name}"
    y, x, channel = np.mgrid[:32, :32, :6]
    weight = np.float32((channel == 0) * (1 + np.sin(x / 5) * np.cos(y / 7)))
    expected = difference(scene, params, key, weight)
    dr.enable_grad(params[key])
    params.update()
    dr.backward(dr.sum(mi.render(scene, params, seed=1) * mi.TensorXf(weight), axis=None))
    assert np.array(dr.grad(params[key])).sum() == pytest.approx(expected, rel=5e-3)


def test_views_rendered_before_one_backward_pass_keep_their_own_lights():
    """The adjoint of each view must see the camera that it was rendered with, not the last one."""
    dr = pytest.importorskip("drjit")
    scene = ball()
    params, rng = mi.traverse(scene), np.random.default_rng(1)
    key, to_world = "ball.bsdf.key", next(k for k in dict(params) if k.endswith(".to_world") and "ball" not in k)
    views = [mi.Transform4f(transform(*angles).matrix) for angles in ((0, 0), (100, 30), (220, -20))]
    weights = [rng.normal(size=(32, 32, 6)).astype(np.float32) for _ in views]
    expected = 0
    for view, weight in zip(views, weights, strict=True):
        params[to_world] = view
        params.update()
        expected += difference(scene, params, key, weight)
    dr.enable_grad(params[key])
    params.update()
    total = 0
    for view, weight in zip(views, weights, strict=True):
        params[to_world] = view
        params.update()
        attached = scene.integrator().render_attached(scene, scene.sensors()[0], seed=1)
        np.testing.assert_allclose(np.array(attached), image(scene, seed=1), atol=1e-6)
        total += dr.sum(attached * mi.TensorXf(weight), axis=None)
    dr.backward(total)
    assert np.array(dr.grad(params[key])).sum() == pytest.approx(expected, rel=5e-3)


def test_silhouettes_see_what_moves_sideways():
    """The area of a disc's image in pixels grows with its radius: only the silhouette tells."""
    dr = pytest.importorskip("drjit")
    scene = mi.load_dict({
        "type": "scene", "integrator": {"type": "monochrome", "aovs": False, "silhouettes": True},
        "sensor": sensor(), "disc": disc(),
    })  # fmt: skip
    params = mi.traverse(scene)
    key = variant.vertex_positions_key("disc")
    scale = mi.Float(1.0)
    dr.enable_grad(scale)
    params[key] = params[key] * scale
    params.update()
    attached = scene.integrator().render_attached(scene, scene.sensors()[0], seed=0, spp=256)
    dr.backward(dr.sum(attached, axis=None))
    area = image(scene, spp=256).sum()
    assert dr.grad(scale)[0] == pytest.approx(2 * area, rel=0.05)


def disc():
    corners = np.arange(24) / 24 * 2 * np.pi
    mesh = mi.Mesh("disc", 25, 24, props=_properties({"type": "twolight"}))
    params = mi.traverse(mesh)
    rim = np.stack([np.cos(corners), np.sin(corners), 0 * corners], axis=1)
    params["vertex_positions"] = np.float32(np.concatenate([rim, [[0, 0, 0]]])).ravel()
    params["faces"] = np.uint32([[i, (i + 1) % 24, 24] for i in range(24)]).ravel()
    params.update()
    return mesh


@pytest.mark.parametrize(
    "wrong",
    [{"lights": "sideways"}, {"ambient": 1.0}, {"ambient": -0.1}, {"sharpness": 0.0}, {"sharpness": -3.0},
     {"key": [0, 0, 0]}, {"fill": [0.0, 0.0, 0.0]}, {"shininess": 3.0}],
)  # fmt: skip
def test_bad_parameters_are_refused_by_name(wrong):
    with pytest.raises(RuntimeError, match=next(iter(wrong))):
        mi.load_dict({"type": "twolight", **wrong})


def test_silhouettes_exclude_aovs():
    with pytest.raises(RuntimeError, match="silhouettes"):
        mi.load_dict({"type": "monochrome", "silhouettes": True})


def test_other_materials_are_refused_by_name():
    scene = mi.load_dict(
        {"type": "scene", "integrator": {"type": "monochrome"}, "sensor": sensor(), "ball": {"type": "sphere"}}
    )
    with pytest.raises(Exception, match='renders "twolight" materials only'):
        scene.integrator().render(scene)


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

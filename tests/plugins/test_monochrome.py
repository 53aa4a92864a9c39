"""The integrator on shapes whose depth and normals are known in closed form, and its derivatives."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from shading import DISTANCE, FOV, PARAMETERS, ball, camera, image, properties, sensor, transform

from genmf_mi.render import variant


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
    mesh = mi.Mesh("disc", 25, 24, props=properties({"type": "twolight"}))
    params = mi.traverse(mesh)
    rim = np.stack([np.cos(corners), np.sin(corners), 0 * corners], axis=1)
    params["vertex_positions"] = np.float32(np.concatenate([rim, [[0, 0, 0]]])).ravel()
    params["faces"] = np.uint32([[i, (i + 1) % 24, 24] for i in range(24)]).ravel()
    params.update()
    return mesh


def test_silhouettes_exclude_aovs():
    with pytest.raises(RuntimeError, match="silhouettes"):
        mi.load_dict({"type": "monochrome", "silhouettes": True})


def test_other_materials_are_refused_by_name():
    scene = mi.load_dict(
        {"type": "scene", "integrator": {"type": "monochrome"}, "sensor": sensor(), "ball": {"type": "sphere"}}
    )
    with pytest.raises(Exception, match='renders "twolight" materials only'):
        scene.integrator().render(scene)

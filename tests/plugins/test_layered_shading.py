"""Layers that are too fine to see: the tabulated normals against closed forms, the material against its formula in
NumPy and against balls and cones whose layers are modelled one by one."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from genmf_mi.plugins.layers import NORMALS, SLOPES, VIEWS, Layers, visible_normals
from scipy.ndimage import gaussian_filter
from shading import ball, camera, grey, image, sensor

ROUND = 0.5


def shares(slope: float, view: float, bulge: float = ROUND) -> np.ndarray:
    return visible_normals(bulge)[np.argmin(np.abs(SLOPES - slope)), np.argmin(np.abs(VIEWS - view))]


class TestVisibleNormals:
    def test_sum_to_one(self):
        table = visible_normals(ROUND)
        np.testing.assert_allclose(table.sum(axis=-1), 1, atol=1e-12)
        assert table.min() >= 0

    def test_level_view_of_a_wall_sees_round_sides(self):
        """Of a half circle seen from its side, a normal takes part with its cosine."""
        fine = np.radians(np.linspace(-90, 90, 20001))
        hat = np.array([np.interp(np.degrees(fine), NORMALS, row) for row in np.eye(len(NORMALS))])
        expected = (hat * np.cos(fine)).sum(axis=1) / np.cos(fine).sum()
        np.testing.assert_allclose(shares(0, 0), expected, atol=0.015)

    @pytest.mark.parametrize("slope", [60, 76])
    def test_from_above_a_stair_shows_its_treads(self, slope):
        """Of a period tan β, the side of the bead takes its bulge and the tread the rest."""
        # The flattest of the twelve facets of the side counts as tread for the most part
        tread = 1 - ROUND / np.tan(np.radians(slope))
        assert shares(slope, 90)[-1] == pytest.approx(tread, abs=0.03)
        assert shares(slope, 90, bulge=0.0)[-1] == pytest.approx(1, abs=1e-9)

    def test_square_beads_show_sides_and_treads_only(self):
        """Seen level, a stair of sharp edges is a wall."""
        np.testing.assert_allclose(shares(44, 0, bulge=0.0)[[7, 8]], 0.5, atol=1e-9)

    def test_upside_down(self):
        """Where the smooth surface faces the viewer."""
        table = visible_normals(ROUND)
        front = np.cos(np.radians(VIEWS - SLOPES[:, None])) > 0.03
        np.testing.assert_allclose(table[front], table[::-1, ::-1, ::-1][front], atol=0.02)


def mix(normals: np.ndarray, views: np.ndarray, up: np.ndarray, axes: np.ndarray, bulge: float = ROUND) -> np.ndarray:
    """G of unit normals ``[N,3]`` seen from ``views [N,3]``, in NumPy, one at a time."""
    table, angles, out = visible_normals(bulge), np.radians(NORMALS), np.zeros(len(normals))
    for i, (n, view) in enumerate(zip(normals, views)):
        outward = n - (n @ up) * up
        slope = np.degrees(np.arctan2(n @ up, np.linalg.norm(outward)))
        outward /= np.linalg.norm(outward)
        seen = np.degrees(np.arctan2(view @ up, view @ outward))
        rows = [np.interp(seen, VIEWS, table[k, :, m]) for k in range(len(SLOPES)) for m in range(len(NORMALS))]
        rows = np.reshape(rows, (len(SLOPES), len(NORMALS)))
        weights = [np.interp(slope, SLOPES, rows[:, m]) for m in range(len(NORMALS))]
        micro = np.cos(angles)[:, None] * outward + np.sin(angles)[:, None] * up
        out[i] = weights @ grey(micro, axes)
    return out


@pytest.mark.parametrize("name", ["llvm_ad_mono", "cuda_ad_mono"])
@pytest.mark.parametrize("build", [[0.0, 1.0, 0.0], [2.0, 1.0, 0.0]])
def test_grey_value_is_the_formula(switch, name, build):
    switch(name)
    seen = image(ball({"layers": True, "build": build}, azimuth=130, elevation=-35, resolution=16), seed=3)
    normals = seen[seen[..., -1] == 1][:, -4:-1]
    origin, axes = camera(130, -35)
    views = origin - normals  # points of the unit ball
    views /= np.linalg.norm(views, axis=1, keepdims=True)
    expected = mix(normals, views, np.array(build) / np.linalg.norm(build), axes)
    assert len(normals) > 40
    np.testing.assert_allclose(seen[seen[..., -1] == 1][:, 0], expected, atol=2e-4)


def revolved(outline: np.ndarray, around: int = 360):
    """Mesh of facets around y, of an outline ``[P,2]`` (radius, height) from below to above, which it closes."""
    outline = np.concatenate([[[1e-4, outline[0, 1]]], outline, [[1e-4, outline[-1, 1]]]])
    angle = np.arange(around) / around * 2 * np.pi
    r, y = outline.T
    points = np.stack([r[:, None] * np.sin(angle), np.broadcast_to(y[:, None], (len(r), around)),
                       r[:, None] * np.cos(angle)], axis=-1)  # fmt: skip
    a = np.arange(len(r) - 1)[:, None] * around + np.arange(around)
    b = np.arange(len(r) - 1)[:, None] * around + (np.arange(around) + 1) % around
    faces = np.concatenate([np.stack([a, b, b + around], -1), np.stack([a, b + around, a + around], -1)])
    mesh = mi.Mesh("revolved", points.size // 3, faces.size // 3)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = points.astype(np.float32).ravel()
    parameters["faces"] = faces.astype(np.uint32).ravel()
    parameters.update()
    return mesh


def stacked(radius, count: int, bulge: float = ROUND) -> np.ndarray:
    """Outline of ``count`` beads from y = -1 to 1 whose sides touch ``radius(y)`` half-way up."""
    height = 2 / count
    angle = np.linspace(-np.pi / 2, np.pi / 2, 11)
    middle = -1 + height * (np.arange(count)[:, None] + 0.5)
    r = radius(middle) + bulge * height * (np.cos(angle) - 1)
    return np.stack([np.maximum(r, 1e-4), middle + height / 2 * np.sin(angle)], axis=-1).reshape(-1, 2)


def photographed(mesh, material: dict, elevation: float) -> np.ndarray:
    """Grey value, normal and coverage, averaged over some layers."""
    mesh.set_bsdf(mi.load_dict({"type": "twolight", **material}))
    camera = sensor(20, elevation, resolution=192, samples=64, sampler="stratified")
    scene = mi.load_dict({"type": "scene", "integrator": {"type": "monochrome"}, "mesh": mesh, "sensor": camera})
    return gaussian_filter(image(scene), (4, 4, 0))


BODIES = {
    "ball": lambda y: np.sqrt(np.maximum(1 - y**2, 0)),
    "cone": lambda y: 0.5 * (1.05 - y),
    "vase": lambda y: 0.6 + 0.3 * np.sin(2.5 * y),
}


@pytest.mark.parametrize("body", list(BODIES))
@pytest.mark.parametrize("elevation", [20, -10, 60])
def test_explicit_layers(body, elevation):
    """The difference over slopes up to 60°, root mean square; it is 0.003 at most here, and that of the smooth surface
    0.07 to 0.13."""
    y = np.linspace(-1, 1, 801)
    smooth = revolved(np.stack([np.maximum(BODIES[body](y), 1e-4), y], axis=-1))
    modelled = photographed(smooth, {"layers": True}, elevation)
    plain = photographed(smooth, {}, elevation)
    explicit = photographed(revolved(stacked(BODIES[body], 200)), {}, elevation)

    inside = (modelled[..., -1] > 0.9999) & (explicit[..., -1] > 0.9999)
    inside &= np.abs(modelled[..., 3]) < np.sin(np.radians(60))
    assert inside.sum() > 500

    def rms(picture: np.ndarray) -> float:
        return float(np.sqrt(np.square(picture[..., 0] - explicit[..., 0])[inside].mean()))

    assert rms(modelled) < 0.005
    assert rms(modelled) < rms(plain) / 20


def test_gradient():
    """With respect to the smooth normal, against central differences inside a cell of the table."""
    rng = np.random.default_rng(1)
    normals = rng.normal(size=(64, 3))
    normals[:, 1] *= 0.5
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    views = normals + 0.6 * rng.normal(size=(64, 3))
    views /= np.linalg.norm(views, axis=1, keepdims=True)
    table, up = Layers(ROUND), mi.Vector3f(0, 1, 0)

    def value(n: np.ndarray):
        n = mi.Vector3f(n.T.astype(np.float32))
        dr.enable_grad(n)
        light = dr.normalize(mi.Vector3f(-0.4, 0.5, 1))
        total = sum(
            w * dr.square(dr.fmax(dr.dot(m, light), 0)) for w, m in table.normals(n, mi.Vector3f(views.T), up, True)
        )
        return n, total

    n, total = value(normals)
    dr.backward(dr.sum(total))
    found = np.array(dr.grad(n)).T
    step = 2e-3
    for axis in range(3):
        ahead, behind = (np.array(value(normals + s * step * np.eye(3)[axis])[1]) for s in (1, -1))
        expected = (ahead - behind) / (2 * step)
        close = np.abs(found[:, axis] - expected) < 0.02 + 0.05 * np.abs(expected)
        assert close.mean() > 0.85  # the others step over the edge of a cell


def test_layers_are_an_option():
    plain, layered = (image(ball(material, resolution=8)) for material in ({}, {"layers": True}))
    assert np.abs(plain - layered).max() > 0.05
    with pytest.raises(Exception, match="bulge"):
        ball({"layers": True, "bulge": 2.0})
    with pytest.raises(Exception, match="build"):
        ball({"layers": True, "build": [0, 0, 0]})

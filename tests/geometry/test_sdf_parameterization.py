"""Relief on Φ: the shell, the bounds, the derivatives, the end; on small grids."""

from __future__ import annotations

import igl
import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree

from genmf_mi.assets.sdf_asset import SdfAsset
from genmf_mi.core.frame import Frame
from genmf_mi.geometry.displacement_bounds import DisplacementBounds
from genmf_mi.geometry.sdf import SdfParameterization, SdfState
from genmf_mi.geometry.sdf_distance import free_weights, slope
from genmf_mi.losses.sdf import l_dev, sdf_tv
from genmf_mi.mesh.manifold import is_solid
from genmf_mi.mesh.measures import vertex_normals
from genmf_mi.mesh.nearest import distance_to_surface
from genmf_mi.mesh.self_intersections import self_intersections
from genmf_mi.sdf import flexicubes
from genmf_mi.sdf.distance import signed_distance
from genmf_mi.sdf.grid import without_small_components
from genmf_mi.sdf.shell import shell

CAP = 0.06
SAMPLES = 33


def grid(samples: int = SAMPLES) -> np.ndarray:
    axis = np.linspace(-1, 1, samples)
    return np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)


def ball(samples: int = SAMPLES, radius: float = 0.7, steepness: float = 1.0, **options) -> SdfAsset:
    phi = steepness * (np.linalg.norm(grid(samples), axis=-1) - radius)
    return SdfAsset("ball", phi.astype(np.float32), **options)


def generated() -> SdfAsset:
    """A bent ellipsoid as a generator holds it: not a distance, in its own units, with deformation and weights."""
    x, y, z = np.moveaxis(grid(), -1, 0)
    phi = 2 * (np.sqrt((x + 0.2 * y**2) ** 2 + (1.4 * y) ** 2 + z**2) - 0.62)
    rng = np.random.default_rng(0)
    bend = rng.uniform(-0.3, 0.3, (SAMPLES,) * 3 + (3,)) / (SAMPLES - 1)
    weights = rng.normal(0, 0.3, ((SAMPLES - 1) ** 3, 21))
    return SdfAsset("blob", phi.astype(np.float32), bend.astype(np.float32), weights.astype(np.float32),
                    centre=(1.0, 2.0, 3.0), half=0.5)  # fmt: skip


def parameterized(asset: SdfAsset, inward=CAP, outward=CAP, *, smoothing: float = 3.0, wavelength: float = 1.0):
    vertices, faces = asset.surface(training=True)
    frame = Frame.of(vertices, 100.0)
    vertices = frame.normalise(vertices)
    bounds = DisplacementBounds(*(np.broadcast_to(x, len(vertices)).astype(float) for x in (inward, outward, 0)))
    normals = vertex_normals(vertices, faces)
    return SdfParameterization(
        asset, frame, vertices, faces, normals, bounds, smoothing=smoothing, wavelength=wavelength
    )


def disturbed(geometry: SdfParameterization, strength: float = 1.0, seed: int = 0) -> SdfParameterization:
    """The same with random parameters, smooth in the field and free in deformation and weights."""
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for parameter, size in zip(geometry.parameters, (1.0, 0.5, 0.5)):
            random = torch.randn(parameter.numel(), generator=generator).view_as(parameter)
            parameter.copy_(strength * size * random)
    return geometry


@pytest.mark.parametrize("bent", [False, True])
def test_shell_against_brute_force(bent):
    asset = generated() if bent else ball()
    vertices, faces = asset.surface(training=True)
    vertices = asset.to_grid(vertices)
    found = shell(asset.phi < 0, asset.deformation, vertices, faces, CAP)
    cell = 2 / (SAMPLES - 1)
    places = grid() if asset.deformation is None else grid() + asset.deformation
    distance = distance_to_surface(places.reshape(-1, 3), vertices, faces)
    np.testing.assert_array_equal(found.samples, np.flatnonzero(distance <= CAP + cell))
    np.testing.assert_allclose(found.distance, distance[found.samples], atol=1e-12)
    np.testing.assert_allclose(found.places, places.reshape(-1, 3)[found.samples])
    closest = np.einsum("nc,nck->nk", found.weights, vertices[faces[found.face]])
    np.testing.assert_allclose(np.linalg.norm(closest - found.places, axis=1), found.distance, atol=1e-6)

    index = np.stack(np.unravel_index(found.samples, (SAMPLES,) * 3), axis=1)
    apart = np.abs(index[found.edges[:, 0]] - index[found.edges[:, 1]])
    assert (apart.sum(axis=1) == 1).all()
    members = set(map(tuple, index))
    pairs = sum(tuple(i + step) in members for i in index for step in np.eye(3, dtype=int))
    assert len(np.unique(np.sort(found.edges, axis=1), axis=0)) == len(found.edges) == pairs

    n = SAMPLES - 1
    centres = (np.stack(np.unravel_index(found.cubes, (n, n, n)), axis=1) + 0.5) * cell - 1
    np.testing.assert_allclose(found.centres, centres)
    all_centres = (grid()[:-1, :-1, :-1] + cell / 2).reshape(-1, 3)
    near = distance_to_surface(all_centres, vertices, faces) <= CAP + 0.87 * cell
    np.testing.assert_array_equal(found.cubes, np.flatnonzero(near))


class TestAtRest:
    @pytest.mark.parametrize("asset", [ball(), generated()], ids=["ball", "generated"])
    def test_is_the_assets_own_surface(self, asset):
        geometry = parameterized(asset)
        now = geometry.geometry()
        np.testing.assert_array_equal(now.faces, geometry.faces)
        np.testing.assert_allclose(now.vertices.detach(), geometry.vertices, atol=2e-6)
        assert now.shape.detach().equal(torch.tensor(asset.phi)) and geometry.initial_shape.equal(
            torch.tensor(asset.phi)
        )
        part = geometry.finish(geometry.state(), self_intersections)
        np.testing.assert_allclose(part.vertices, geometry.vertices, atol=2e-6)
        np.testing.assert_allclose(part.offsets, 0, atol=2e-6)
        assert part.report["samples_held_back"] == 0

    def test_weights_of_some_cubes(self):
        """The generator's rows are looked up; a cube without any has zeros."""
        asset = generated()
        rows = np.full((SAMPLES - 1) ** 3, -1, np.int32)
        rows[[5, 9]] = 1, 0
        some = SdfAsset("some", asset.phi, weights=asset.weights[:2], rows=rows)
        np.testing.assert_array_equal(
            free_weights(some, np.array([5, 7, 9])),
            np.stack([asset.weights[1], 0 * asset.weights[0], asset.weights[0]]),
        )
        np.testing.assert_array_equal(free_weights(asset, np.array([3, 8])), asset.weights[[3, 8]])
        assert not free_weights(ball(), np.array([3, 8])).any()


class TestBounds:
    def test_phi_stays_within_the_cap(self):
        geometry = disturbed(parameterized(ball()), 100.0)
        change = (geometry.geometry().shape - geometry.initial_shape).detach() * geometry.scale
        assert 0.9 * CAP < change.abs().max() <= CAP * 1.03, "the slope of this field is one but for the sampling"

    @pytest.mark.parametrize("strength", [0.3, 3.0])
    @pytest.mark.parametrize("asset", [ball(), generated()], ids=["ball", "generated"])
    def test_finished_surface_is_a_solid_within_its_bounds(self, asset, strength):
        """Whatever the parameters are: closed, not through itself, and no vertex farther from the initial surface."""
        part = parameterized(asset)
        room = [np.where(part.vertices[:, 0] > 0, CAP, 0.3 * CAP), np.where(part.vertices[:, 0] > 0, 0.5 * CAP, CAP)]
        geometry = disturbed(parameterized(asset, *room), strength)
        before = len(self_intersections(geometry.vertices, geometry.faces))
        done = geometry.finish(geometry.state(), self_intersections)
        assert is_solid(done.vertices, done.faces)
        assert len(self_intersections(done.vertices, done.faces)) <= before
        assert done.report["self_intersections_before"] == before
        squared, face, _ = igl.point_mesh_squared_distance(done.vertices, geometry.vertices, geometry.faces)
        height = np.einsum("vk,vk->v", done.offsets, done.normals)
        inward, outward = (x[geometry.faces[face]].max(axis=1) for x in room)
        most = np.where(height > 0, outward, inward)
        assert (np.sqrt(squared) <= most + 1e-9).all() and np.sqrt(squared).max() > 0.4 * CAP
        np.testing.assert_allclose(np.linalg.norm(done.normals, axis=1), 1)

    @pytest.mark.parametrize("failures", [1, 4])
    def test_back_off_stays_where_it_is_needed(self, failures):
        """First deformation and weights go, and where that is not enough Φ; all else is left as it was."""
        geometry = disturbed(parameterized(ball()))
        spot, answers = geometry.vertices[0], iter([0] + [1] * failures + [0])

        def crossings(vertices, faces):
            return np.argsort(np.linalg.norm(vertices[faces].mean(axis=1) - spot, axis=1))[: next(answers)]

        def cells_apart(points, others, low, high):
            """Of ``points`` between so many cells from the spot."""
            cell = geometry.cell * geometry.scale
            away = np.linalg.norm(points - spot, axis=1) / cell
            return cKDTree(others).query(points[(away >= low) & (away < high)])[0].max() / cell

        before = geometry.surface(geometry.state())[0]
        done = geometry.finish(geometry.state(), crossings)
        assert done.report["untangled"] == 1 and 0 < done.report["samples_held_back"] < len(geometry.samples) / 4
        with torch.no_grad():
            for parameter in geometry.parameters[1:]:
                parameter.zero_()
        plain = geometry.surface(geometry.state())[0]
        wanted, other = (plain, geometry.vertices) if failures == 1 else (geometry.vertices, plain)
        assert cells_apart(done.vertices, wanted, 0, 1) < 0.02 < 0.1 < cells_apart(before, wanted, 0, 1)
        assert cells_apart(done.vertices, other, 0, 1) > 0.1
        assert cells_apart(before, done.vertices, 9, np.inf) < 1e-9

    def test_without_end_to_intersections_the_initial_surface_is_left(self):
        geometry = disturbed(parameterized(ball()), 3.0)
        calls = iter(range(1000))
        done = geometry.finish(geometry.state(), lambda v, f: np.arange(min(next(calls), 1)))
        np.testing.assert_allclose(done.vertices, geometry.vertices, atol=2e-6)

    def test_without_bounds_nothing_moves(self):
        still = disturbed(parameterized(ball(), 0.0, 0.0), 10.0).geometry()
        np.testing.assert_allclose(still.vertices.detach(), parameterized(ball()).vertices, atol=1e-5)

    def test_specks_and_cavities_go(self):
        """A bubble off the ball, and one in it."""
        phi = ball(radius=0.6).phi.copy()
        phi[3, 3, 3], phi[16, 16, 16] = -0.1, 0.1
        clean, count = without_small_components(phi)
        assert count == 2 and ((clean < 0) == (ball(radius=0.6).phi < 0)).all()
        np.testing.assert_array_equal(np.abs(clean), np.abs(phi))
        same, none = without_small_components(ball().phi)
        assert none == 0 and same is not None and np.array_equal(same, ball().phi)

    def test_bodies_of_some_size_stay(self):
        phi = np.minimum(ball(radius=0.4).phi, np.linalg.norm(grid() - 0.7, axis=-1) - 0.2)
        assert without_small_components(phi)[1] == 0


class TestStart:
    def test_displaced_ball_has_another_radius(self):
        """On average to a hundredth of a cell, everywhere to a tenth."""
        geometry = parameterized(ball())
        radius = np.linalg.norm(geometry.vertices, axis=1).mean()
        for height in (0.03, -0.03):
            vertices, faces = geometry.surface(geometry.displaced(np.full(len(geometry.vertices), height)))
            assert is_solid(vertices, faces)
            found = np.linalg.norm(vertices, axis=1)
            assert found.mean() == pytest.approx(radius + height, abs=6e-4) and np.ptp(found) < 6e-3

    def test_does_not_touch_the_parameters(self):
        """Nor the filter: what is optimised afterwards is without low frequencies all the same."""
        geometry = disturbed(parameterized(ball()))
        before, heights = geometry.geometry().vertices.detach(), np.full(len(geometry.vertices), 0.03)
        state = geometry.displaced(heights)
        assert isinstance(state, SdfState) and not state.filtered and geometry.state().filtered
        geometry.surface(state)
        torch.testing.assert_close(geometry.geometry().vertices.detach(), before, rtol=0, atol=0)

    def test_of_a_field_of_any_slope(self):
        steep = parameterized(ball(steepness=3.0, half=2.0))
        vertices, _ = steep.surface(steep.displaced(np.full(len(steep.vertices), 0.03)))
        flat = parameterized(ball())
        other, _ = flat.surface(flat.displaced(np.full(len(flat.vertices), 0.03)))
        np.testing.assert_allclose(vertices, other, atol=1e-4)

    def test_start_keeps_detail_and_drops_low_frequencies(self):
        geometry = parameterized(ball(49), wavelength=0.3)
        fine, broad = 0.02 * np.cos(25 * geometry.vertices[:, 1]), 0.02 * geometry.vertices[:, 0]
        kept = []
        for heights in (fine, broad):
            geometry.set_heights(heights)
            kept.append(geometry.heights(geometry.state()).square().mean().sqrt().item() / np.sqrt((heights**2).mean()))
        assert kept[0] > 0.6 and kept[1] < 0.2
        assert not any(parameter.any() for parameter in geometry.parameters[1:])


def volume(geometry: SdfParameterization, parameters: tuple[torch.Tensor, ...]) -> torch.Tensor:
    """Enclosed by the surface, weighted by a smooth function, as a function of the parameters."""
    geometry.parameters = parameters
    now = geometry.geometry()
    corner = now.vertices.double()[now.faces]
    share = torch.exp(corner.mean(dim=1)[:, 0])
    return (share * torch.linalg.det(corner)).sum() / 6


@pytest.mark.parametrize("block", [0, 1, 2])
def test_gradient_against_finite_differences(block, monkeypatch):
    """Between two changes of sign: at one, the surface jumps a little."""
    geometry = disturbed(parameterized(generated()), 0.3)
    geometry.geometry()
    monkeypatch.setattr(flexicubes, "topology", lambda inside, fixed=geometry._extract.topology: fixed)
    at = tuple(parameter.detach().clone() for parameter in geometry.parameters)
    (gradient,) = torch.autograd.grad(volume(geometry, geometry.parameters), geometry.parameters[block])
    direction, step = torch.sign(gradient), 2e-3

    def along(shift: float) -> torch.Tensor:
        return volume(geometry, tuple(p + shift * direction if i == block else p for i, p in enumerate(at)))

    with torch.no_grad():
        ahead, behind = along(step), along(-step)
    assert (direction * gradient).sum().item() == pytest.approx((ahead - behind).item() / (2 * step), rel=0.02)


class TestLosses:
    def test_total_variation_by_hand(self):
        rng = np.random.default_rng(0)
        phi = rng.standard_normal((5, 5, 5)).astype(np.float32)
        chosen = [(1, 2, 3), (0, 0, 0), (3, 3, 1)]
        total = 0.0
        for i, j, k in chosen:
            here = phi[i, j, k]
            total += abs(phi[i + 1, j, k] - here) + abs(phi[i, j + 1, k] - here) + abs(phi[i, j, k + 1] - here)
        samples = torch.tensor([np.ravel_multi_index(place, phi.shape) for place in chosen])
        assert sdf_tv(torch.tensor(phi), samples, 0.5).item() == pytest.approx(total / 3 / 0.5, rel=1e-5)

    def test_of_a_distance(self):
        """E|∂Φ| over three axes of unit vectors in all directions: 3 / 2."""
        geometry = parameterized(ball(65))
        terms = geometry.geometry().terms
        assert terms["sdf_tv"].item() == pytest.approx(1.5, rel=0.02)
        assert terms["flexi_weight_reg"].item() == 0
        assert l_dev(torch.tensor([0.1, 0.3]), 0.1).item() == pytest.approx(2.0)

    def test_noise_raises_them(self):
        geometry = parameterized(ball())
        before, after = geometry.geometry().terms, disturbed(geometry).geometry().terms
        assert all(after[name] > before[name] for name in before)

    def test_deformation_gains_weight(self):
        rates = [parameterized(ball()).learning_rates(progress) for progress in (0.0, 0.5, 1.0)]
        assert [r[0] for r in rates] == [2.0] * 3
        assert rates[0][1] == 0 < rates[1][1] < rates[2][1]


class TestDistance:
    def test_on_the_same_grid_it_is_phi(self):
        """But for the margin that the frame leaves: there, the distance to the surface that Φ gave."""
        geometry = parameterized(ball(65))
        distance = geometry.distance(33)
        exact = signed_distance(geometry.vertices, geometry.faces, 33)
        np.testing.assert_array_equal(distance(geometry.initial_shape)[0], exact.astype(np.float32))

    @pytest.mark.parametrize("asset", [ball(65), ball(65, steepness=2.0, centre=(1, 2, 3), half=4.0)])
    def test_follows_the_surface(self, asset):
        geometry = parameterized(asset)
        reached = geometry.displaced(np.full(len(geometry.vertices), 0.03))
        vertices, faces = geometry.surface(reached)
        with torch.no_grad():
            found = geometry.distance(33)(geometry.fields(reached)[0])[0].numpy()
        exact = signed_distance(vertices, faces, 33)
        near = np.abs(exact) < 0.03
        assert near.sum() > 300 and np.abs(found - exact)[near].max() < 3e-3

    def test_gradient(self):
        geometry = parameterized(generated())
        distance = geometry.distance(33)
        weight = torch.randn(1, 33, 33, 33, generator=torch.Generator().manual_seed(0))
        phi = geometry.initial_shape.clone().requires_grad_()
        (gradient,) = torch.autograd.grad((weight * distance(phi)).sum(), phi)
        step = torch.randn(phi.shape, generator=torch.Generator().manual_seed(1))
        change = (
            weight.double() * (distance(geometry.initial_shape + step) - distance(geometry.initial_shape)).double()
        ).sum()
        assert change.item() == pytest.approx((gradient * step).sum().item(), rel=1e-3)


@pytest.mark.parametrize("steepness", [0.5, 1.0, 3.0])
def test_slope(steepness):
    asset = ball(steepness=steepness)
    vertices, faces = asset.surface(training=True)
    around = shell(asset.phi < 0, None, vertices, faces, CAP)
    np.testing.assert_allclose(slope(asset.phi, around.samples, around.distance), steepness, rtol=0.05)

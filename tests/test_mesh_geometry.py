"""What the optimiser moves and what bounds it: large steps, squashing, uniform Adam, room, untangling."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import trimesh
from scipy.sparse import identity
from scipy.sparse.linalg import spsolve

from genmf_mi.geometry.back_off import untangle
from genmf_mi.geometry.displacement_bounds import BEND, SIDEWAYS, SLIM, STANDING, base, bends, lateral_thickness, room
from genmf_mi.geometry.low_pass import low_frequency, low_pass
from genmf_mi.geometry.mesh import ImplicitDiffusion, MeshParameterization, UniformAdam, laplacian
from genmf_mi.mesh import meshlab


def sphere(subdivisions: int = 3, radius: float = 1.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, faces and exact normals."""
    ball = trimesh.creation.icosphere(subdivisions)
    directions = np.array(ball.vertices)
    return radius * directions, np.array(ball.faces), directions


def noise(*shape: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(shape)


def nowhere(points: np.ndarray, _directions: np.ndarray) -> np.ndarray:
    return np.full(len(points), np.inf)


class TestSmoother:
    def test_laplacian_is_valence_minus_adjacency(self):
        """A tetrahedron, and two triangles with a boundary."""
        closed = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]])
        np.testing.assert_array_equal(laplacian(closed, 4).toarray(), 4 * np.eye(4) - 1)
        open_ = laplacian(np.array([[0, 1, 2], [2, 1, 3]]), 4).toarray()
        np.testing.assert_array_equal(open_, [[2, -1, -1, 0], [-1, 3, -1, -1], [-1, -1, 3, -1], [0, -1, -1, 2]])
        path = laplacian(np.array([[0, 1], [1, 2]]), 3).toarray()
        np.testing.assert_array_equal(path, [[1, -1, 0], [-1, 2, -1], [0, -1, 1]])

    @pytest.mark.parametrize("smoothing", [0.0, 1.0, 30.0])
    def test_against_scipy(self, smoothing):
        vertices, faces, _ = sphere()
        u = noise(len(vertices), 3)
        matrix = (identity(len(vertices)) + smoothing * laplacian(faces, len(vertices))).tocsc()
        smoother = ImplicitDiffusion(faces, len(vertices), smoothing)
        solved = smoother(torch.tensor(u, dtype=torch.float32))
        np.testing.assert_allclose(solved, spsolve(matrix, u), atol=2e-6 * np.abs(u).max())
        np.testing.assert_allclose(smoother.inverse(solved), u, atol=1e-4)

    def test_gradient(self):
        """The adjoint of a symmetric solve is the same solve; torch may hand over a tensor that is not contiguous."""
        vertices, faces, _ = sphere()
        weight = noise(3, len(vertices))
        u = torch.zeros(len(vertices), 3, requires_grad=True)
        (
            ImplicitDiffusion(faces, len(vertices), 30.0)(u) * torch.tensor(weight, dtype=torch.float32).T
        ).sum().backward()
        matrix = (identity(len(vertices)) + 30 * laplacian(faces, len(vertices))).tocsc()
        np.testing.assert_allclose(u.grad, spsolve(matrix, weight.T), atol=1e-5)


def relief(seed: int = 0, *, broad: bool = False) -> tuple[MeshParameterization, dict[str, np.ndarray]]:
    """A sphere whose vertices have room of different size, some none at all."""
    vertices, faces, normals = sphere()
    rng = np.random.default_rng(seed)
    rooms = {name: rng.uniform(0.001, 0.02, len(vertices)) for name in ("inward", "outward", "sideways")}
    for x in rooms.values():
        x[::7] = 0
    smoother = low_pass(vertices, faces, 0.4) if broad else None
    return MeshParameterization(vertices, normals, faces, *rooms.values(), smoothing=5.0, broad=smoother), rooms


class TestRelief:
    @pytest.mark.parametrize("broad", [False, True])
    @pytest.mark.parametrize("size", [0.0, 1e-8, 1e-3, 1.0, 1e4, 1e12, 1e30])
    def test_never_beyond_the_room(self, size, broad):
        """Whatever the optimiser does to the latent variable."""
        part, rooms = relief(broad=broad)
        with torch.no_grad():
            part.latent.copy_(torch.tensor(size * noise(*part.latent.shape), dtype=torch.float32))
        offsets = part.offsets().detach().numpy().astype(np.float64)
        normals = part.normals.numpy()
        height = (offsets * normals).sum(axis=1)
        across = np.linalg.norm(offsets - height[:, None] * normals, axis=1)
        slack = 1e-6 * 0.02 + 1e-8
        assert np.isfinite(offsets).all()
        assert (height <= rooms["outward"] + slack).all()
        assert (-height <= rooms["inward"] + slack).all()
        assert (across <= rooms["sideways"] + slack).all()
        assert np.abs(offsets[::7]).max() < 1e-8
        if size == 1e4:  # and most of the room can be used
            used = np.abs(height) / np.where(height > 0, rooms["outward"], rooms["inward"]).clip(1e-9)
            assert np.median(used) > 0.9

    def test_small_latents_are_not_squashed(self):
        part, _ = relief()
        with torch.no_grad():
            part.latent.copy_(torch.tensor(1e-6 * noise(*part.latent.shape), dtype=torch.float32))
            free = torch.arange(len(part.base)) % 7 != 0
            torch.testing.assert_close(part.offsets()[free], part.solve(part.latent)[free], rtol=2e-3, atol=1e-9)

    def test_broad_heights_are_taken_out(self):
        """To raise the whole surface is of no use; a vertex among its neighbours may rise."""
        part, rooms = relief(broad=True)
        with torch.no_grad():
            part.latent.copy_(0.01 * part.normals)
            assert part.offsets().abs().max() < 3e-4
            part.latent.copy_(0.5 * part.normals * (torch.arange(len(part.base)) == 100)[:, None])
            heights = (part.offsets() * part.normals).sum(dim=1)
        assert heights.argmax() == 100 and heights[100] > 0.3 * rooms["outward"][100]

    def test_start_from(self):
        part, rooms = relief()
        share = np.random.default_rng(1).uniform(-0.97, 0.97, len(part.base))
        heights = share * np.where(share > 0, rooms["outward"], rooms["inward"])
        part.start_from(heights)
        np.testing.assert_allclose(part.offsets().detach(), heights[:, None] * part.normals.numpy(), atol=1e-6)
        torch.testing.assert_close(part.vertices(), part.base + part.offsets())

    def test_start_beyond_the_room_is_cut(self):
        part, rooms = relief()
        part.start_from(np.full(len(part.base), 1.0))
        np.testing.assert_allclose(
            part.offsets().detach(), 0.98 * rooms["outward"][:, None] * part.normals.numpy(), atol=1e-5
        )

    @pytest.mark.parametrize("broad", [False, True])
    def test_gradient_against_finite_differences(self, broad):
        part, _ = relief(broad=broad)
        weight = torch.tensor(noise(*part.latent.shape, seed=1), dtype=torch.float32)
        latent = torch.tensor(0.01 * noise(*part.latent.shape, seed=2), dtype=torch.float32)
        direction = torch.tensor(noise(*part.latent.shape, seed=3), dtype=torch.float32)

        def value(shift: float) -> torch.Tensor:
            with torch.no_grad():
                part.latent.copy_(latent + shift * direction)
            return (part.offsets() * weight).sum()

        difference = (value(2e-4) - value(-2e-4)).item() / 4e-4
        value(0).backward()
        assert (part.latent.grad * direction).sum().item() == pytest.approx(difference, rel=5e-3)


@pytest.mark.parametrize(("waves", "kept"), [(1, (0.8, 1)), (40, (0, 0.05))])
def test_broad_part(waves, kept):
    """Of a wave of 6.3 on a sphere of radius 1 most, of one of 0.16 nearly nothing; the border is 0.6."""
    vertices, faces, _ = sphere(5)
    field = np.sin(waves * vertices[:, 1])
    near_equator = np.abs(vertices[:, 1]) < 0.5
    broad = low_frequency(vertices, faces, field, 0.6)
    share = (broad * field)[near_equator].sum() / (field**2)[near_equator].sum()
    assert kept[0] <= share <= kept[1]


class TestUniformAdam:
    def test_against_the_formula(self):
        """Ten steps of plain NumPy."""
        parameter = torch.zeros(200, 3, requires_grad=True)
        adam = UniformAdam(parameter, 0.1, beta1=0.8, beta2=0.95)
        x, first, second = np.zeros((200, 3)), np.zeros((200, 3)), np.zeros((200, 3))
        for step in range(1, 11):
            gradient = noise(200, 3, seed=step) ** 3
            parameter.grad = torch.tensor(gradient, dtype=torch.float32)
            adam.step()
            limit = 10 * np.sort(np.abs(gradient).ravel())[593]
            gradient = np.clip(gradient, -limit, limit)
            first, second = 0.8 * first + 0.2 * gradient, 0.95 * second + 0.05 * gradient**2
            scale = np.sqrt(np.sort(second.ravel())[593] / (1 - 0.95**step))
            x -= 0.1 * first / (1 - 0.8**step) / scale
            assert adam.scale == pytest.approx(scale, rel=1e-4)
        np.testing.assert_allclose(parameter.detach(), x, atol=1e-4)
        assert adam.steps == 10
        assert parameter.grad is None

    def test_blocks_are_apart(self):
        """Each is scaled by its own gradients and takes its share of the rate, as if it were alone."""
        together = torch.zeros(300, requires_grad=True)
        adam = UniformAdam(together, 0.1, blocks=(slice(0, 100), slice(100, 300)))
        alone = [torch.zeros(count, requires_grad=True) for count in (100, 200)]
        single = [UniformAdam(part, 0.1) for part in alone]
        for seed in range(3):
            gradient = torch.tensor(noise(300, seed=seed) * np.repeat([1.0, 1e-4], (100, 200)), dtype=torch.float32)
            together.grad = gradient.clone()
            alone[0].grad, alone[1].grad = gradient[:100].clone(), gradient[100:].clone()
            adam.step(0.2, (1.0, 0.25))
            single[0].step(0.2)
            single[1].step(0.05)
        torch.testing.assert_close(together.detach(), torch.cat([part.detach() for part in alone]))
        assert adam.scale == single[0].scale

    def test_first_step_is_the_rate_where_the_gradient_is_uniform(self):
        parameter = torch.zeros(100, 3, requires_grad=True)
        for rate in (None, 0.02):
            before = parameter.detach().clone()
            adam = UniformAdam(parameter, 0.5)
            parameter.grad = torch.full((100, 3), -1e-7)
            adam.step(rate)
            torch.testing.assert_close(parameter.detach() - before, torch.full((100, 3), rate or 0.5))

    def test_one_scale_keeps_proportions(self):
        """Plain Adam would move all vertices alike."""
        parameter = torch.zeros(1000, 1, requires_grad=True)
        parameter.grad = torch.linspace(0.1, 1, 1000)[:, None]
        UniformAdam(parameter, 1.0).step()
        assert (parameter[-1] / parameter[0]).item() == pytest.approx(10, rel=1e-4)

    def test_a_spike_neither_jumps_nor_slows_the_others(self):
        quiet, spiky = (torch.zeros(1000, 1, requires_grad=True) for _ in range(2))
        quiet.grad = torch.ones(1000, 1)
        spiky.grad = torch.ones(1000, 1)
        spiky.grad[500] = 1e6
        UniformAdam(quiet, 0.1).step()
        UniformAdam(spiky, 0.1).step()
        torch.testing.assert_close(spiky[:500], quiet[:500])
        assert spiky[500].abs() < 1.01

    def test_not_a_number_moves_nothing(self):
        parameter = torch.zeros(100, 1, requires_grad=True)
        parameter.grad = torch.ones(100, 1)
        parameter.grad[3], parameter.grad[4] = torch.nan, torch.inf
        UniformAdam(parameter, 0.1).step()
        assert parameter[3] == parameter[4] == 0
        assert parameter.detach()[5] == pytest.approx(-0.1)

    def test_floor(self):
        """A gradient of a hundredth of the floor moves by about a hundredth of the rate."""
        parameter = torch.zeros(100, 1, requires_grad=True)
        parameter.grad = torch.full((100, 1), 1e-4)
        UniformAdam(parameter, 0.1, floor=1e-2).step()
        torch.testing.assert_close(parameter.detach(), torch.full((100, 1), -0.1 / 101))

    def test_no_gradient_no_step(self):
        parameter = torch.zeros(100, 1, requires_grad=True)
        parameter.grad = torch.zeros(100, 1)
        UniformAdam(parameter, 0.1).step()
        assert (parameter == 0).all()


def block(width: float, height: float, depth: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A box in small triangles, centred, and its angle-weighted normals."""
    box = trimesh.creation.box([width, height, depth])
    vertices, faces = trimesh.remesh.subdivide_to_size(box.vertices, box.faces, 0.12)
    mesh = trimesh.Trimesh(vertices, faces)
    mesh.merge_vertices()
    return np.array(mesh.vertices), np.asarray(mesh.faces), np.array(mesh.vertex_normals)


def box_exit(half):
    """The distance from points in a box of the half extents ``half [3]`` to its walls, along directions."""

    def gap(points, directions):
        with np.errstate(divide="ignore", invalid="ignore"):
            walls = (np.sign(directions) * half - points) / directions
        walls[np.abs(directions) < 1e-9] = np.inf
        leaves = walls.min(axis=1)
        return np.where(leaves > 1e-9, leaves, np.inf)

    return gap


def aloft(vertices, faces, normals, *rest):
    """:func:`room` of a surface far above the bed."""
    lone = np.concatenate([vertices, [[0.0, -100.0, 0.0]]])
    return tuple(x[:-1] for x in room(lone, faces, np.concatenate([normals, [[0.0, -1.0, 0.0]]]), *rest))


class TestRoom:
    def test_sphere(self):
        """Inwards it converges at the centre, outwards it opens; the cap counts where it is smaller."""
        vertices, faces, normals = sphere(4, radius=0.3)
        convex, hollow = bends(vertices, faces, normals)
        np.testing.assert_allclose(convex, 1 / 0.3, rtol=1e-6)
        np.testing.assert_allclose(hollow, 0, atol=1e-9)
        inward, outward, sideways = aloft(vertices, faces, normals, 10.0, 0.0, nowhere)
        np.testing.assert_allclose(inward, BEND * 0.3, rtol=1e-6)
        np.testing.assert_allclose(outward, 10.0, rtol=1e-4)
        inside_out = aloft(vertices, faces[:, ::-1], -normals, 10.0, 0.0, nowhere)
        np.testing.assert_allclose(inside_out[1], BEND * 0.3, rtol=1e-6)
        inward, outward, sideways = aloft(vertices, faces, normals, 0.05, 0.0, nowhere)
        edges = np.linalg.norm(vertices[faces] - vertices[np.roll(faces, 1, axis=1)], axis=2)
        assert 0 < sideways.min() <= sideways.max() <= SIDEWAYS * edges.max()
        for x in (inward, outward):
            assert (np.hypot(x, sideways) <= 0.05 * (1 + 1e-9)).all()
            assert (np.hypot(x, sideways) > 0.049).all()

    def test_thin_wall(self):
        """Two opposite walls may together take what exceeds the wall that must remain; outwards the cap holds."""
        vertices, faces, normals = block(1.0, 0.2, 1.0)

        def gap(points, directions):
            """Exact for the upper and lower side, far elsewhere."""
            through = (np.abs(directions[:, 1]) > 0.99) & (np.sign(directions[:, 1]) != np.sign(points[:, 1]))
            return np.where(through, 0.2, np.inf)

        middle = (np.abs(normals[:, 1]) > 0.99) & (np.abs(vertices[:, [0, 2]]).max(axis=1) < 0.3)
        middle &= vertices[:, 1] > 0  # the lower side is the base
        for wall in (0.0, 0.05, 0.15):
            inward, outward, _ = aloft(vertices, faces, normals, 0.15, wall, gap)
            assert (2 * inward[middle] <= 0.2 - wall).all()
            assert (inward[middle] > 0.4 * (0.2 - wall) * 0.98).all()
            np.testing.assert_allclose(outward[middle], 0.15, rtol=0.07)
        inward, outward, sideways = aloft(vertices, faces, normals, 0.15, 0.25, gap)
        assert (inward[middle] == 0).all() and (sideways[middle] == 0).all()
        assert (outward[middle] > 0.14).all()

    def test_narrow_gap(self):
        """Both sides of a slot may grow towards each other, and must not meet."""
        vertices, faces, normals = sphere(3)

        def gap(points, directions):
            """A tenth ahead, far elsewhere: the body is bulky."""
            return np.where(np.einsum("nk,nk->n", points, directions) > 0.99, 0.1, 5.0)

        _, outward, _ = aloft(vertices, faces, normals, 0.5, 0.0, gap)
        assert (outward > 0.02).all() and (2 * outward < 0.1).all()

    @pytest.mark.parametrize(
        ("size", "width"), [((1.0, 0.2, 0.2), 0.2), ((0.3, 2.0, 0.2), 0.3), ((1.0, 0.2, 0.8), 0.8)]
    )
    def test_limb_width(self, size, width):
        """A rod is as wide as it is thick; a plate is as wide as its shorter side, however thin it is."""
        vertices, _, normals = block(*size)
        gap = box_exit(np.array(size) / 2)
        thin = np.argmin(size)
        central = np.delete(np.abs(vertices) / size, thin, axis=1).max(axis=1) < 0.1  # corners are narrower
        through = gap(vertices, -normals)
        found = lateral_thickness(vertices, normals, through, gap)[central & (np.abs(normals[:, thin]) > 0.999)]
        # Four directions: at worst the shortest way across is missed by an eighth of a turn
        assert (found >= width * (1 - 1e-6)).all() and (found <= width * 1.09).all()

    def test_limbs_keep_their_outline(self):
        vertices, faces, normals = block(0.2, 2.0, 0.2)
        inward, outward, _ = room(vertices, faces, normals, 0.1, 0.0, box_exit(np.array([0.1, 1.0, 0.1])))
        side = np.abs(vertices[:, 1]) < 0.5
        assert max(inward[side].max(), outward[side].max()) <= SLIM * 0.2 * 1.09

    def test_a_tight_spot_limits_its_surroundings(self):
        vertices, faces, normals = sphere(3)
        near_pole = vertices[:, 1] > 0.999
        _, outward, _ = aloft(
            vertices, faces, normals, 0.5, 0.0, lambda *_: np.append(np.where(near_pole, 0.01, 1.0), 1.0)
        )
        tight = outward < 0.01
        assert 5 < tight.sum() < 50 and (vertices[tight, 1] > 0.9).all()

    def test_what_stands_goes_on_standing(self):
        """Of two feet neither is lifted, whatever the relief, and nothing comes to lie below them."""
        left, faces, normals = sphere(3, radius=0.3)
        right = left + np.array([1.0, 0.01, 0.0])
        vertices, normals = np.concatenate([left, right]), np.concatenate([normals, normals])
        inward, outward, _ = room(vertices, np.concatenate([faces, faces + len(left)]), normals, 0.1, 0.0, nowhere)
        lowest = vertices[:, 1].min()
        for foot in (np.arange(len(left)), len(left) + np.arange(len(right))):
            at = foot[vertices[foot, 1].argmin()]
            assert max(inward[at], outward[at]) <= STANDING * 0.01 * (1 + 1e-9)
        assert (vertices + outward[:, None] * normals)[:, 1].min() >= lowest
        high = vertices[:, 1] > 0
        np.testing.assert_allclose(outward[high], 0.1, rtol=0.03)

    def test_flat_base_is_pinned(self):
        vertices, faces, normals = block(1.0, 0.6, 0.8)
        standing = vertices[:, 1] == vertices[:, 1].min()
        np.testing.assert_array_equal(base(vertices, faces), np.flatnonzero(standing))
        for x in room(vertices, faces, normals, 0.05, 0.0, nowhere):
            assert (x[standing] == 0).all()
            assert (x[vertices[:, 1] > 0] > 0).all()

    def test_no_base(self):
        """A ball touches the bed in a point; a tilted block on an edge; a block with a pin stands on little."""
        vertices, faces, _ = sphere(3)
        assert len(base(vertices, faces)) == 0
        vertices, faces, _ = block(1.0, 0.6, 0.8)
        assert len(base(vertices @ trimesh.transformations.rotation_matrix(0.5, [0, 0, 1])[:3, :3].T, faces)) == 0
        pin = trimesh.creation.box([0.05, 0.1, 0.05])
        pin.apply_translation([0, -0.34, 0])
        joined = trimesh.boolean.union([trimesh.Trimesh(vertices, faces), pin])
        assert len(base(joined.vertices, joined.faces)) == 0

    def test_hollow_bend_limits_outwards(self):
        """The inner corner of an angle; the outer edge limits inwards."""
        angle = trimesh.boolean.difference(
            [
                trimesh.creation.box([1, 1, 1]),
                trimesh.creation.box(
                    [0.5, 1, 2], transform=trimesh.transformations.translation_matrix([0.25, 0.25, 0])
                ),
            ]
        )
        vertices, faces = trimesh.remesh.subdivide_to_size(angle.vertices, angle.faces, 0.1, max_iter=20)
        mesh = trimesh.Trimesh(vertices, faces)
        mesh.merge_vertices()
        vertices, faces = np.array(mesh.vertices), np.asarray(mesh.faces)
        convex, hollow = bends(vertices, faces, np.array(mesh.vertex_normals))
        ends = np.abs(vertices[:, 2]) > 0.3
        corner = np.isclose(vertices[:, 0], 0) & np.isclose(vertices[:, 1], -0.25) & ~ends
        flat = np.isclose(vertices[:, 0], -0.5) & (np.abs(vertices[:, 1]) < 0.3) & ~ends
        assert corner.sum() >= 3 and (hollow[corner] > 5).all() and (convex[corner] < 1e-6).all()
        assert flat.sum() >= 3 and (hollow[flat] < 1e-6).all() and (convex[flat] < 1e-6).all()


class TestUntangle:
    @staticmethod
    def folded(vertices: np.ndarray, normals: np.ndarray, seed: int) -> np.ndarray:
        """Smooth relief, and a patch of a dozen vertices that are thrown about by more than an edge length."""
        offsets = 0.02 * np.sin(5 * vertices[:, :1]) * normals
        patch = np.linalg.norm(vertices - vertices[seed], axis=1) < 0.15
        return offsets + patch[:, None] * 0.1 * noise(len(vertices), 3)

    def test_a_folded_patch(self):
        vertices, faces, normals = sphere(4)
        offsets = self.folded(vertices, normals, 100)
        first = len(meshlab.self_intersections(vertices + offsets, faces))
        assert first > 0
        result, report = untangle(vertices, faces, offsets, meshlab.self_intersections)
        assert len(meshlab.self_intersections(vertices + result, faces)) == 0
        assert report["self_intersections_before"] == 0 and report["untangled"] == first
        changed = (result != offsets).any(axis=1)
        assert report["vertices_held_back"] == changed.sum() > 0
        assert changed.mean() < 0.1 and changed[100]
        share = (result * offsets).sum(axis=1) / np.maximum((offsets**2).sum(axis=1), 1e-20)
        np.testing.assert_allclose(result, share[:, None] * offsets, atol=1e-9)
        assert share.min() >= 0 and share.max() <= 1 + 1e-9

    def test_what_crossed_before_may_cross_still(self):
        """An asset's own defect is left as it is, and costs the relief elsewhere nothing."""
        vertices, faces, normals = sphere(4)
        vertices = vertices + self.folded(vertices, normals, 100)
        before = len(meshlab.self_intersections(vertices, faces))
        offsets = self.folded(vertices, normals, 900)
        result, report = untangle(vertices, faces, offsets, meshlab.self_intersections)
        assert report["self_intersections_before"] == before > 0
        assert len(meshlab.self_intersections(vertices + result, faces)) <= before
        assert (result == offsets).all(axis=1).mean() > 0.8

    def test_sound_relief_is_left_alone(self):
        vertices, faces, normals = sphere(3)
        offsets = 0.02 * np.sin(5 * vertices[:, :1]) * normals
        result, report = untangle(vertices, faces, offsets, meshlab.self_intersections)
        np.testing.assert_array_equal(result, offsets)
        assert report == {"self_intersections_before": 0, "untangled": 0, "vertices_held_back": 0}

    def test_what_cannot_be_untangled_is_given_up(self):
        """Rather no relief than a part that cuts through itself."""
        vertices, faces, normals = sphere(2)

        def stubborn(points, _faces):
            return np.arange(3) if np.abs(points - vertices).max() > 1e-9 else np.empty(0, np.int64)

        result, _ = untangle(vertices, faces, 0.1 * normals, stubborn)
        assert np.abs(result).max() == 0

"""FlexiCubes: a plain oracle, closed meshes from any field, gradients, weights."""

from __future__ import annotations

from itertools import product

import igl
import numpy as np
import pytest
import torch
from fields import ball, grid, random_field, random_weights

from genmf_mi.losses.sdf import flexi_weight_reg
from genmf_mi.mesh import measures, topology
from genmf_mi.sdf import cube_cases, dual_topology
from genmf_mi.sdf.flexicubes import ALPHA, BETA, GAMMA, WEIGHTS, FlexiCubes, bounded_weights

EDGES = cube_cases.EDGES


def oracle(phi: np.ndarray, move: np.ndarray, weights, training: bool) -> list[np.ndarray]:
    """Triangles ``[3,3]`` one by one: patches traced on the faces of each cube, no tables."""
    n = phi.shape[0] - 1
    place = 2 * np.stack(np.indices(phi.shape), axis=-1) / n - 1 + move
    alpha, beta, gamma = (np.asarray(part) for part in weights)
    inside = phi < 0

    def at(cube, corner):
        return tuple(cube[k] + (corner >> k & 1) for k in range(3))

    def sides(cube):
        for axis, side in product(range(3), (0, 1)):
            u, v = np.roll(np.eye(3, dtype=int), -axis - 1, axis=0)[:2]
            start = np.array(cube) + side * np.eye(3, dtype=int)[axis]
            yield [tuple(map(int, start + step)) for step in (0 * u, u, u + v, v)]

    def loops(cube, other_pairs_on=None):
        """The patches of a cube as lists of grid edges, and the faces that one passes twice."""
        links, pairs_on = {}, {}
        for face in sides(cube):
            edges = [tuple(sorted((face[k - 1], face[k]))) for k in range(4)]
            pairs = []
            for k in range(4):  # at corner k meet the edges k and k + 1
                apart = inside[face[k]] == (frozenset(face) != other_pairs_on)
                if apart and inside[face[k - 1]] != inside[face[k]] != inside[face[(k + 1) % 4]]:
                    pairs.append((edges[k], edges[(k + 1) % 4]))
            crossed = [edge for edge in edges if inside[edge[0]] != inside[edge[1]]]
            pairs = [tuple(crossed)] if len(crossed) == 2 else pairs
            pairs_on[frozenset(face)] = pairs
            for a, b in pairs:
                links.setdefault(a, []).append(b)
                links.setdefault(b, []).append(a)
        found = []
        while links:
            loop = [next(iter(links))]
            while (following := [edge for edge in links[loop[-1]] if edge not in loop]) != []:
                loop.append(following[0])
            for edge in loop:
                del links[edge]
            found.append(loop)
        twice = {face for face, pairs in pairs_on.items() for loop in found if sum(a in loop for a, _ in pairs) == 2}
        return found, twice

    cubes = list(product(range(n), repeat=3))
    twice = {cube: loops(cube)[1] for cube in cubes}
    shared = {}
    for cube in cubes:
        for face in twice[cube]:
            shared.setdefault(face, []).append(cube)
    other = {cube: face for face, both in shared.items() if len(both) == 2 for cube in both}

    around = {}
    for number, cube in enumerate(cubes):
        corner = {at(cube, c): c for c in range(8)}
        for loop in loops(cube, other.get(cube))[0]:
            total, weight = np.zeros(3), 0.0
            for a, b in loop:
                ca, cb = corner[a], corner[b]
                sa, sb = alpha[number, ca] * phi[a], alpha[number, cb] * phi[b]
                bias = beta[number, EDGES.index((ca, cb) if (ca, cb) in EDGES else (cb, ca))]
                total, weight = total + bias * (sa * place[b] - sb * place[a]) / (sa - sb), weight + bias
            for edge in loop:
                around.setdefault(edge, []).append((cube, total / weight, gamma[number]))

    triangles = []
    for (a, b), ring in around.items():
        if len(ring) < 4:
            continue
        start, stop = (np.array(a), np.array(b)) if inside[a] else (np.array(b), np.array(a))
        out = stop - start
        axis = int(np.flatnonzero(out)[0])
        u, v = np.roll(np.eye(3), -axis - 1, axis=0)[:2] * [[1], [out[axis]]]
        offsets = [np.array(cube) + 0.5 - (start + stop) / 2 for cube, _, _ in ring]
        order = np.argsort([np.arctan2(offset @ v, offset @ u) for offset in offsets])
        p, g = [ring[k][1] for k in order], [ring[k][2] for k in order]
        one, two = g[0] * g[2], g[1] * g[3]
        if training:
            middle = (one * (p[0] + p[2]) / 2 + two * (p[1] + p[3]) / 2) / (one + two)
            triangles += [np.array([p[k], p[(k + 1) % 4], middle]) for k in range(4)]
        else:
            corners = ((0, 1, 2), (0, 2, 3)) if one > two else ((0, 1, 3), (1, 2, 3))
            triangles += [np.array([p[k] for k in three]) for three in corners]
    return triangles


def canonical(triangles) -> np.ndarray:
    """Triangles ``[F,9]``, each turned so that its least corner is first, sorted."""
    turned = [np.roll(t, -min(range(3), key=lambda k, t=t: tuple(t[k])), axis=0).ravel() for t in triangles]
    return np.array(sorted(map(tuple, turned)))


@pytest.mark.parametrize("training", [True, False])
@pytest.mark.parametrize("border", [True, False])
def test_against_a_plain_oracle(training, border):
    """Random signs, weights and deformations, closed or running into the border of the grid."""
    m, problems = 7, 0
    for seed in range(4):
        phi = random_field(m, seed, torch.float64)
        if not border:
            phi = torch.rand(m, m, m, generator=torch.Generator().manual_seed(seed), dtype=torch.float64) - 0.65
        move = 0.1 * torch.randn(m, m, m, 3, generator=torch.Generator().manual_seed(seed)).double().tanh()
        raw = random_weights(m, seed, torch.float64)
        extract = FlexiCubes(0.5)
        surface = extract(phi, move, raw, training=training)
        expected = oracle(phi.numpy(), move.numpy(), bounded_weights(raw, 0.5), training)
        corners = surface.vertices.numpy()[surface.faces.numpy()]
        np.testing.assert_allclose(canonical(corners), canonical(expected), atol=1e-12)
        problems += int((extract.topology.cubes.new_tensor(_inverted_cubes(phi))).sum())
    assert problems > 0, "no case was inverted"


def _inverted_cubes(phi: torch.Tensor) -> np.ndarray:
    """Which of the surface cubes have inverted cases."""
    inside, n = phi < 0, phi.shape[0] - 1
    case = dual_topology._cases(inside)
    cubes = ((case > 0) & (case < 255)).nonzero().squeeze(1)
    doubled = torch.as_tensor(cube_cases.tables()[1])
    return dual_topology._inverted(case, cubes, doubled[case[cubes].long()], doubled, n).numpy()


class TestClosed:
    def test_all_cases_on_random_fields(self):
        """Closed, edges with two faces that run along them in opposite ways, one fan of faces at every vertex."""
        seen, inverted = set(), 0
        for seed in range(30):
            phi = random_field(16, seed)
            seen |= set(dual_topology._cases(phi < 0).tolist())
            inverted += int(_inverted_cubes(phi).sum())
            for training in (True, False):
                surface = FlexiCubes()(phi, None, random_weights(16, seed), training=training)
                faces = surface.faces.numpy()
                assert topology.is_closed(faces)
                assert igl.split_nonmanifold(faces)[0].max() + 1 == len(surface.vertices) == faces.max() + 1
                assert measures.signed_volume(surface.vertices.numpy(), faces) > 0
        assert seen == set(range(256)) and inverted > 100

    def test_ambiguous_faces_need_their_handling(self, monkeypatch):
        monkeypatch.setattr(dual_topology, "_inverted", lambda _case, cubes, *_: torch.zeros_like(cubes))
        surfaces = [FlexiCubes()(random_field(16, seed), training=False) for seed in range(5)]
        nonmanifold = [topology.boundary_and_nonmanifold_edges(surface.faces.numpy())[1] for surface in surfaces]
        assert sum(nonmanifold) > 0

    def test_open_only_at_the_border(self):
        phi = grid(9)[..., 0] - 0.1  # a half space
        surface = FlexiCubes()(phi, training=False)
        assert topology.boundary_and_nonmanifold_edges(surface.faces.numpy())[1] == 0
        assert torch.allclose(surface.vertices[:, 0], torch.tensor(0.1), atol=1e-6)
        corner = surface.vertices[surface.faces]
        assert (torch.linalg.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])[:, 0] > 0).all()

    def test_samples_that_are_exactly_zero_are_outside(self):
        phi = grid(9).norm(dim=-1) - 0.5  # zero at six samples
        surface = FlexiCubes()(phi.requires_grad_(True))
        surface.vertices.sum().backward()
        assert topology.is_closed(surface.faces.numpy())
        assert torch.isfinite(surface.vertices).all() and torch.isfinite(phi.grad).all()

    def test_a_field_without_a_surface(self):
        phi = torch.ones(5, 5, 5, requires_grad=True)
        surface = FlexiCubes()(phi, None, torch.zeros(64, WEIGHTS))
        assert surface.vertices.shape == surface.faces.shape == (0, 3)
        surface.vertices.sum().backward()
        assert not phi.grad.any()


class TestGradients:
    @pytest.mark.parametrize("name", ["phi", "deformation", "alpha", "beta", "gamma"])
    def test_against_finite_differences(self, name):
        """Of vertices and deviations in every input, in double precision, along random directions."""
        m, step = 8, 1e-6
        generator = torch.Generator().manual_seed(3)
        phi = ball(grid(m, torch.float64)) + 0.02 * torch.randn(m, m, m, generator=generator, dtype=torch.float64)
        inputs = {
            "phi": phi,
            "deformation": 0.05 * torch.randn(m, m, m, 3, generator=generator, dtype=torch.float64),
            "weights": random_weights(m, 4, torch.float64),
        }
        mask = torch.zeros(WEIGHTS, dtype=torch.float64)
        mask[{"alpha": ALPHA, "beta": BETA, "gamma": GAMMA}.get(name, slice(0))] = 1
        moved = inputs[name if name in inputs else "weights"]
        extract = FlexiCubes()

        def value() -> torch.Tensor:
            surface = extract(inputs["phi"], inputs["deformation"], inputs["weights"])
            factors = torch.linspace(-1, 1, surface.vertices.numel(), dtype=torch.float64).sin()
            return (surface.vertices.reshape(-1) * (9 * factors).sin()).sum() + surface.deviation.square().sum()

        moved.requires_grad_(True)
        (gradient,) = torch.autograd.grad(value(), moved)
        moved.requires_grad_(False)
        for _ in range(5):
            along = torch.randn(moved.shape, generator=generator, dtype=torch.float64)
            along = along if name in inputs else along * mask
            along[(moved.abs() < 1e-3)] = 0  # keeps every sign
            moved += step * along
            up = value()
            moved -= 2 * step * along
            down = value()
            moved += step * along
            difference = float((up - down) / (2 * step))
            assert abs(difference) > 1e-4
            assert float((gradient * along).sum()) == pytest.approx(difference, rel=1e-5, abs=1e-9)

    def test_float32_agrees_with_double(self):
        phi, weights = random_field(12, 1), random_weights(12, 1)
        single, double = (FlexiCubes()(phi.to(t), None, weights.to(t)) for t in (torch.float32, torch.float64))
        assert single.vertices.dtype == torch.float32
        assert torch.allclose(single.vertices.double(), double.vertices, atol=1e-5)


class TestParts:
    def test_ranges(self):
        raw = torch.linspace(-50, 50, 10)[:, None].expand(-1, WEIGHTS)
        for spread in (0.5, 0.99):
            alpha, beta, gamma = bounded_weights(raw, spread)
            for part in (alpha, beta, 2 * gamma):
                assert part.min() == pytest.approx(1 - spread, abs=1e-6)
                assert part.max() == pytest.approx(1 + spread, abs=1e-6)
        neutral = bounded_weights(torch.zeros(1, WEIGHTS))
        assert (neutral.alpha == 1).all() and (neutral.beta == 1).all() and neutral.gamma.item() == 0.5

    def test_zero_weights_are_no_weights(self):
        phi = random_field(9, 0)
        one, other = FlexiCubes()(phi), FlexiCubes()(phi, torch.zeros(9, 9, 9, 3), torch.zeros(512, WEIGHTS))
        assert torch.equal(one.vertices, other.vertices) and torch.equal(one.faces, other.faces)

    def test_weights_of_some_cubes_only(self):
        """Compact rows give what the full table with zeros elsewhere gives, gradients too."""
        phi, full = random_field(9, 0), random_weights(9, 0)
        chosen = torch.arange(0, 512, 2)
        rows = torch.full((512,), -1, dtype=torch.int32)
        rows[chosen] = torch.arange(len(chosen), dtype=torch.int32)
        full[1::2] = 0
        some = full[chosen].requires_grad_(True)
        full.requires_grad_(True)
        results = FlexiCubes()(phi, None, full), FlexiCubes(rows=rows)(phi, None, some)
        assert torch.equal(results[0].vertices, results[1].vertices)
        for result in results:
            result.vertices.square().sum().backward()
        assert torch.allclose(full.grad[chosen], some.grad, atol=1e-6) and some.grad.any()

    def test_deviation_is_that_of_distances_to_the_crossings(self):
        """One corner inside, crossings at different distances: worked out by hand."""
        phi = torch.ones(4, 4, 4)
        phi[1, 1, 1] = -1.0
        phi[2, 1, 1] = 3.0  # the crossing is at a quarter of this edge, at half of all others
        surface = FlexiCubes()(phi)
        index = 2 / 3 * torch.tensor([[1.25, 1, 1], [1, 1.5, 1], [1, 1, 1.5]]) - 1  # crossings of the cube (1, 1, 1)
        vertex = index.mean(dim=0)
        distance = (index - vertex).norm(dim=1)
        row = int((surface.vertices[: len(surface.deviation)] - vertex).norm(dim=1).argmin())
        assert torch.allclose(surface.vertices[row], vertex)
        assert surface.deviation[row] == pytest.approx(float((distance - distance.mean()).abs().mean()))

    def test_topology_is_kept_while_the_signs_stay(self):
        extract, phi = FlexiCubes(), random_field(9, 0)
        extract(phi)
        first = extract.topology
        extract(phi * 2)
        assert extract.topology is first
        phi[4, 4, 4] *= -1
        extract(phi)
        assert extract.topology is not first

    def test_regulariser_of_the_weights(self):
        phi, weights = random_field(9, 0), torch.zeros(512, WEIGHTS)
        assert flexi_weight_reg(FlexiCubes()(phi, None, weights).weights) == 0
        weights = torch.zeros(1, WEIGHTS)
        weights[0, :2] = torch.tensor([1.0, -3.0])
        assert flexi_weight_reg(weights).item() == pytest.approx(10 / WEIGHTS)

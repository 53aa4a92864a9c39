"""What keeps stress down: the losses against slow sums, their gradients against differences, and the held gradient."""

from __future__ import annotations

import copy
import itertools

import numpy as np
import pytest
import torch
import trimesh

from genmf_mi.core.config import Weights
from genmf_mi.geometry.mesh_distance import MeshDistance
from genmf_mi.losses import stress as losses
from genmf_mi.sdf.distance import signed_distance
from genmf_mi.stress import penalty as penalties
from genmf_mi.stress.fem.following import MEASURES
from genmf_mi.stress.model import compute
from genmf_mi.stress.model.network import Architecture, StressNetwork, crop_box
from genmf_mi.stress.penalty import FREE, TOLERATED, StressPenalty, by_network, hinge, towards

N = 33
CELL = 2 / (N - 1)
BAND = 0.2


def body() -> trimesh.Trimesh:
    """A ball with bumps, longest side about 1.8."""
    mesh = trimesh.creation.icosphere(subdivisions=3)
    x, y, z = mesh.vertices.T
    bumps = 1 + 0.1 * np.sin(6 * x) * np.cos(5 * y + 1) + 0.05 * np.sin(7 * z)
    return trimesh.Trimesh(mesh.vertices * bumps[:, None] * [0.85, 0.6, 0.7], mesh.faces, process=False)


def tensor(array: np.ndarray, **options) -> torch.Tensor:
    return torch.tensor(np.asarray(array), dtype=torch.float64, **options)


class Tiny:
    """A small network in double precision instead of the trained one."""

    def __init__(self) -> None:
        torch.manual_seed(0)
        self.network = StressNetwork(Architecture(4, block_size=2, poolings=2, grid=N)).double()
        torch.nn.init.constant_(self.network.fusion.out.bias, 0.2)
        self.network.requires_grad_(False)
        self.boxes = []

    def field(self, phi: torch.Tensor, box: tuple[slice, slice, slice]) -> torch.Tensor:
        self.boxes.append(box)
        return compute.stress(self.network, phi, bfloat16=False, box=box)


@pytest.fixture(scope="module")
def tiny() -> Tiny:
    return Tiny()


class TestLosses:
    DEPTH = 0.3

    @pytest.fixture
    def fields(self) -> tuple[np.ndarray, np.ndarray]:
        """Stress and Φ of a small grid."""
        rng = np.random.default_rng(0)
        return rng.uniform(0.1, 4, size=(1, 7, 7, 7)), rng.normal(scale=0.3, size=(1, 7, 7, 7))

    def slow(self, phi: np.ndarray, depth: float | None) -> np.ndarray:
        """One sample after the other."""
        weight, cell = np.zeros_like(phi), 2 / 6
        for place in itertools.product(*map(range, phi.shape)):
            inside = min(max(-phi[place] / (0.5 * cell), 0), 1)
            near = 1.0 if depth is None else min(max((phi[place] + depth) / cell + 0.5, 0), 1)
            weight[place] = inside * near
        return weight

    def test_against_loops(self, fields) -> None:
        stress, phi = fields
        for depth in (None, self.DEPTH):
            weight = self.slow(phi, depth)
            fast = losses.body(tensor(phi)) if depth is None else losses.band(tensor(phi), depth)
            np.testing.assert_allclose(fast, weight, atol=1e-12)
            mean = sum(w * s for w, s in zip(weight.flat, stress.flat)) / weight.sum()
            variance = sum(w * (s - mean) ** 2 for w, s in zip(weight.flat, stress.flat)) / weight.sum()
            assert float(losses.mean(tensor(stress), fast)) == pytest.approx(mean, rel=1e-12)
            assert float(losses.variance(tensor(stress), fast)) == pytest.approx(variance, rel=1e-12)

    def test_peak_is_between_mean_and_maximum(self, fields) -> None:
        stress, phi = map(tensor, fields)
        weight = losses.body(phi)
        low, high = losses.mean(stress, weight), stress[weight > 0].max()
        peaks = [float(losses.peak(stress, weight, power)) for power in (1, 8, 400)]
        assert peaks[0] == pytest.approx(float(low)) and low < peaks[1] < high
        assert peaks[2] == pytest.approx(float(high), rel=0.02)
        power = (np.average(stress.numpy() ** 8, weights=weight)) ** (1 / 8)
        assert peaks[1] == pytest.approx(power)
        assert float(losses.peak(2 * stress, weight)) == pytest.approx(2 * peaks[1])

    def test_of_a_constant_field(self) -> None:
        """Whatever the shape, the mean is the constant and the variance nothing."""
        phi = tensor(np.random.default_rng(1).normal(size=(1, 5, 5, 5)))
        field, weight = torch.full_like(phi, 0.7), losses.body(phi)
        for value in (losses.mean(field, weight), losses.peak(field, weight)):
            assert float(value) == pytest.approx(0.7)
        assert float(losses.variance(field, weight)) == pytest.approx(0, abs=1e-15)

    def test_far_inside_and_outside(self) -> None:
        """A sample half a cell below the surface counts fully; the band ends at its depth; nothing outside counts."""
        cell = 2 / 8
        phi = torch.full((1, 9, 9, 9), 0.1, dtype=torch.float64)
        phi[0, 0, 0, :6] = tensor([-0.25, -0.5, -1.0, -1.5, -2.5, -4.0]) * cell
        assert losses.body(phi)[0, 0, 0].tolist() == pytest.approx([0.5, 1, 1, 1, 1, 1, 0, 0, 0])
        assert losses.band(phi, 1.5 * cell)[0, 0, 0].tolist() == pytest.approx([0.5, 1, 1, 0.5, 0, 0, 0, 0, 0])
        assert float(losses.body(phi).sum()) == pytest.approx(5.5)

    def test_volume_under_a_moving_surface(self) -> None:
        """A ball's weights follow its volume as it grows, without jumps."""
        ticks = torch.linspace(-1, 1, N, dtype=torch.float64)
        radius = torch.stack(torch.meshgrid(ticks, ticks, ticks, indexing="ij")).norm(dim=0)[None]
        volumes = np.array([float(losses.body(radius - r).sum()) for r in np.linspace(0.5, 0.5 + CELL, 60)])
        assert (np.diff(volumes) > 0).all() and np.diff(volumes).max() < 2.5 * np.diff(volumes).mean()
        exact = 4 / 3 * np.pi * (0.5 - CELL * losses.RAMP_CELLS / 2) ** 3 / CELL**3
        assert volumes[0] == pytest.approx(exact, rel=0.02)


def test_gradients_against_differences(tiny) -> None:
    """Of E, Var and E over the band with respect to the vertices, through Φ and a network, within 2 %."""
    mesh = body()
    vertices = tensor(mesh.vertices, requires_grad=True)
    distance = MeshDistance(mesh.faces, N, every=1000)
    with torch.no_grad():
        box = crop_box(distance(vertices))

    def measures(place: torch.Tensor) -> torch.Tensor:
        phi = distance(place)
        field, weight = tiny.field(phi, box), losses.body(phi)
        band = losses.band(phi, 0.15)
        terms = [losses.mean(field, weight), losses.variance(field, weight), losses.mean(field, band)]
        return torch.stack([*terms, losses.peak(field, weight)])

    gradients = [torch.autograd.grad(m, vertices, retain_graph=True)[0] for m in measures(vertices)]
    step = 1e-6
    for direction in (tensor(mesh.vertex_normals), tensor(np.sin(3 * mesh.vertices))):
        with torch.no_grad():
            slopes = (measures(vertices + step * direction) - measures(vertices - step * direction)) / (2 * step)
        for gradient, slope in zip(gradients, slopes):
            assert float((gradient * direction).sum()) == pytest.approx(float(slope), rel=0.02)


class TestPenalty:
    """The penalty of a shape that moves, evaluated every third call; growing raises the measures of this network."""

    @pytest.fixture(autouse=True)
    def strict(self, monkeypatch) -> None:
        """Increases count from the first on, as those of this network are small."""
        monkeypatch.setattr(penalties, "FREE", 0.0)
        monkeypatch.setattr(penalties, "TOLERATED", 0.01)

    def penalty(self, tiny: Tiny, every: int = 3, weights: Weights | None = None) -> tuple[StressPenalty, torch.Tensor]:
        mesh = body()
        tiny.boxes.clear()
        start = tensor(mesh.vertices)
        # One search, as each moves the samples deep inside by hundredths of a cell
        self.distance = MeshDistance(mesh.faces, N, every=1000)
        measure = by_network(tiny, self.distance, start, BAND)
        return StressPenalty(measure, start, every=every, weights=weights), start

    def hinged(self, ratios: dict[str, float]) -> dict[str, float]:
        roots = {name: ratio**0.5 if name == "stress_variance" else ratio for name, ratio in ratios.items()}
        return {name: float(hinge(torch.tensor(root - 1, dtype=torch.float64))[0]) for name, root in roots.items()}

    def test_is_nothing_at_the_start(self, tiny) -> None:
        held, start = self.penalty(tiny)
        loss, ratios = held(start)
        assert tuple(ratios) == MEASURES
        assert list(ratios.values()) == pytest.approx([1, 1, 1, 1], rel=1e-9)
        assert float(loss) == pytest.approx(0, abs=1e-9)

    @pytest.mark.parametrize("scale", [0.97, 0.995, 1.002, 1.02, 1.05])
    def test_only_increases_count_and_small_ones_less(self, tiny, scale) -> None:
        held, start = self.penalty(tiny)
        moved = scale * start
        loss, ratios = held(moved)
        assert float(loss) == pytest.approx(sum(self.hinged(ratios).values()), rel=1e-9, abs=1e-15)
        largest = max(ratio**0.5 if name == "stress_variance" else ratio for name, ratio in ratios.items()) - 1
        assert held.strength == pytest.approx(min(max(largest / 0.01, 0), 1))

    def test_ratios_are_relative_to_the_start(self, tiny) -> None:
        held, start = self.penalty(tiny)
        moved = 1.02 * start
        _, ratios = held(moved)
        values = []
        for shape in (start, moved):
            phi = self.distance(shape).numpy()
            field = tiny.field(tensor(phi), tiny.boxes[0]).numpy()
            weight = np.clip(-phi / (0.5 * CELL), 0, 1)
            near = weight * np.clip(0.5 + (phi + BAND) / CELL, 0, 1)
            mean = np.average(field, weights=weight)
            variance = np.average((field - mean) ** 2, weights=weight)
            peak = np.average(field**8, weights=weight) ** (1 / 8)
            values.append([mean, variance, np.average(field, weights=near), peak])
        assert list(ratios.values()) == pytest.approx(list(np.divide(values[1], values[0])), rel=1e-6)

    def test_is_linear_in_between(self, tiny) -> None:
        held, start = self.penalty(tiny)
        rng = np.random.default_rng(0)
        first = (1.02 * start).requires_grad_()
        loss, ratios = held(first)
        (gradient,) = torch.autograd.grad(loss, first)
        assert float(gradient.abs().max()) > 0
        for _ in range(2):
            moved = (1.02 * start + tensor(1e-3 * rng.normal(size=start.shape))).requires_grad_()
            value, told = held(moved)
            (same,) = torch.autograd.grad(value, moved)
            assert torch.equal(same, gradient) and told == ratios
            expected = loss.detach() + (gradient * (moved - first)).sum().detach()
            assert float(value.detach()) == pytest.approx(float(expected), rel=1e-12)

    def test_leads_back_and_nowhere_else(self, tiny) -> None:
        """Vertices that have not moved stay; along the offsets of the others the derivative is the true one, wherever
        it asks for less relief."""
        held, start = self.penalty(tiny, every=1)
        moves = start[:, 0] > 0
        offset = torch.where(moves[:, None], 0.02 * start, torch.zeros_like(start))
        place = (start + offset).requires_grad_()
        (gradient,) = torch.autograd.grad(held(place)[0], place)
        assert not gradient[~moves].any() and gradient[moves].any()
        along = (gradient * offset).sum(dim=1)
        assert (along >= 0).all()
        assert (
            float((gradient - along[:, None] * offset / (offset**2).sum(1, True).clamp_min(1e-20)).abs().max()) < 1e-12
        )
        less = along > 0  # of these the penalty knows the derivative
        step = 1e-4 * offset * less[:, None]
        values = [float(held(start + offset + sign * step)[0]) for sign in (1, -1)]
        assert float((gradient * step).sum()) == pytest.approx((values[0] - values[1]) / 2, rel=0.02)

    @pytest.mark.parametrize(("every", "evaluations"), [(1, 7), (3, 3), (10, 1)])
    def test_is_evaluated_every_few_calls_in_one_crop(self, tiny, every, evaluations) -> None:
        held, start = self.penalty(tiny, every)
        for i in range(7):
            held((1 + 0.03 * i) * start)
        assert len(tiny.boxes) == 1 + evaluations
        assert all(box == tiny.boxes[0] for box in tiny.boxes)

    def test_of_phi_itself(self, tiny) -> None:
        """Where the shape is Φ, every value is drawn back to what it was, or not at all."""
        phi = tensor(signed_distance(body().vertices, body().faces, N))[None]
        held = StressPenalty(by_network(tiny, lambda shape: shape, phi, BAND), phi, every=1)
        place = (phi - 0.01 * (phi > -0.5)).requires_grad_()
        loss, _ = held(place)
        (gradient,) = torch.autograd.grad(loss, place)
        offset = (place - phi).detach()
        assert (gradient * offset >= 0).all() and gradient.any() and not gradient[offset == 0].any()
        assert held(place.detach() - 1e-3 * offset * (gradient != 0))[0] < loss

    def test_weights_of_the_measures(self, tiny) -> None:
        weights = Weights(stress_mean=2.0, stress_variance=0.0, stress_band=0.5, stress_peak=0.0)
        held, start = self.penalty(tiny, 1, weights)
        value, ratios = held(1.02 * start)
        hinged = self.hinged(ratios)
        assert float(value) == pytest.approx(2.0 * hinged["stress_mean"] + 0.5 * hinged["stress_band"], rel=1e-9)
        assert tuple(ratios) == MEASURES, "all are reported"

    @pytest.mark.parametrize("calls", [1, 2, 3, 4])
    def test_continued_from_its_state(self, tiny, calls) -> None:
        """Whether an evaluation is due next or not: the same values and gradients, bit by bit."""
        whole, start = self.penalty(tiny)
        shapes = [(1 + 0.01 * i) * start for i in range(6)]
        for shape in shapes[:calls]:
            whole(shape)
        other, _ = self.penalty(tiny)
        other.load_state_dict(copy.deepcopy(whole.state_dict()))
        for shape in shapes[calls:]:
            pair = []
            for penalty in (whole, other):
                place = shape.clone().requires_grad_()
                value, ratios = penalty(place)
                pair.append((value.detach(), torch.autograd.grad(value, place)[0], ratios))
            assert torch.equal(pair[0][0], pair[1][0]) and torch.equal(pair[0][1], pair[1][1])
            assert pair[0][2] == pair[1][2]


def test_hinge_is_smooth() -> None:
    x = torch.linspace(-0.05, 0.15, 2001, dtype=torch.float64)
    value, slope = hinge(x)
    assert not value[x <= FREE].any() and not slope[x <= FREE].any()
    assert torch.equal(slope[x >= TOLERATED + 1e-9], torch.ones_like(slope[x >= TOLERATED + 1e-9]))
    torch.testing.assert_close((value[2:] - value[:-2]) / (x[2:] - x[:-2]), slope[1:-1], atol=2e-3, rtol=0)


def test_towards_of_vertices_and_of_values() -> None:
    start, offset = torch.zeros(3, 3), torch.tensor([[1.0, 0, 0], [0, 2.0, 0], [0, 0, 0]])
    gradient = torch.tensor([[3.0, 4.0, 0], [1.0, -1.0, 0], [1.0, 1.0, 1.0]])
    expected = torch.tensor([[3.0, 0, 0], [0, 0, 0], [0, 0, 0]])
    assert torch.equal(towards(start, offset, gradient), expected)
    values = towards(
        torch.zeros(1, 1, 4), torch.tensor([[[1.0, -1.0, 1.0, 0.0]]]), torch.tensor([[[2.0, -3.0, -1.0, 5.0]]])
    )
    assert torch.equal(values, torch.tensor([[[2.0, -3.0, 0.0, 0.0]]]))

"""The body whose mesh follows its surface: its looks, their derivatives, and what it makes of too much motion."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from genmf_mi.core.frame import Frame
from genmf_mi.stress.fem.body_mesh import FINEST, MOST_NODES, mesh_edge
from genmf_mi.stress.fem.following import MEASURES, FollowingBody
from genmf_mi.stress.fem.settings import Settings
from genmf_mi.stress.fem.simulation import simulate_distance

N, NODES = 65, 2500
FRAME = Frame((0.0, 0.0, 0.0), 1.0, 100.0)


def egg(radii: tuple[float, float, float] = (0.75, 0.6, 0.5)) -> np.ndarray:
    """Φ of an egg, nearly a distance."""
    axis = np.linspace(-1, 1, N)
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)
    return ((np.linalg.norm(points / radii, axis=-1) - 1) * min(radii)).astype(np.float32)


@pytest.fixture(scope="module")
def body() -> FollowingBody:
    return FollowingBody(egg(), FRAME, Settings(), NODES, tolerance=1e-7)


def ripple(points: np.ndarray) -> np.ndarray:
    """A smooth motion, a share of a cell."""
    return 0.02 * np.sin(7 * points[:, [1, 2, 0]] + [0, 1, 2]) * points


class TestFollowingBody:
    def test_stays_as_it_was(self, body):
        """No motion gives the field of a simulation on the same mesh."""
        still = body.measures(torch.zeros(len(body.points), 3, dtype=torch.float64))
        edge_mm = mesh_edge(egg(), NODES) * FRAME.mm_per_unit
        field = simulate_distance(egg(), FRAME, Settings(edge_mm=edge_mm)).field
        mean = np.average(field.von_mises, weights=field.elements.volumes)
        variance = np.average((field.von_mises - mean) ** 2, weights=field.elements.volumes)
        peak = np.average(field.von_mises**8, weights=field.elements.volumes) ** (1 / 8)
        assert [float(still[i]) for i in (0, 1, 3)] == pytest.approx([mean, variance, peak], rel=1e-6)
        assert len(still) == len(MEASURES)

    def test_larger_is_the_same_as_meshed_anew(self, body):
        """A body that grows by four hundredths, against a mesh of it of its own."""
        grown = body.measures(torch.from_numpy(0.04 * body.points))
        anew = FollowingBody(egg((0.78, 0.624, 0.52)), FRAME, Settings(), NODES)
        expected = anew.measures(torch.zeros(len(anew.points), 3, dtype=torch.float64))
        assert grown[:3].tolist() == pytest.approx(expected[:3].tolist(), rel=0.02)
        assert float(grown[3]) == pytest.approx(float(expected[3]), rel=0.05)  # where the clamp ends, by few cells

    @pytest.mark.parametrize("index", range(len(MEASURES)))
    def test_gradient_against_differences(self, body, index):
        motion = torch.from_numpy(ripple(body.points)).requires_grad_()
        (gradient,) = torch.autograd.grad(body.measures(motion)[index], motion)
        direction = torch.from_numpy(np.cos(5 * body.points + [2, 0, 1]))
        # The lowest and the highest node would change places, where the clamp has a kink
        heights = body.points[:, 1]
        direction[(heights < heights.min() + 0.05) | (heights > heights.max() - 0.05)] = 0
        step = 2e-4
        values = [float(body.measures(motion.detach() + sign * step * direction)[index]) for sign in (1, -1)]
        slope = (values[0] - values[1]) / (2 * step)
        assert float((gradient * direction).sum()) == pytest.approx(slope, rel=0.01)

    def test_looks_do_not_depend_on_one_another(self, body):
        first, second = (torch.from_numpy(scale * ripple(body.points)) for scale in (1.0, -1.0))
        before = body.measures(first)
        body.measures(second)
        assert torch.equal(body.measures(first), before)

    def test_cells_are_not_crushed(self, body):
        """However far the surface moves, the field is one of a sound mesh."""
        wild = np.random.default_rng(0).normal(scale=0.2, size=body.points.shape)
        _, field, follows = body.solve(wild)
        assert field.mesh.volumes.min() > 0 and (follows < 1).any()
        assert np.isfinite(field.von_mises).all()
        assert body.solve(ripple(body.points))[2].min() == 1

    def test_printed_another_way_up(self):
        """On its back it is the body that was turned before it was printed upright."""
        lying = FollowingBody(egg(), FRAME.standing((0.0, 0.0, 1.0)), Settings(), NODES)
        turned = FollowingBody(egg((0.75, 0.5, 0.6)), FRAME, Settings(), NODES)
        found, expected = (b.measures(torch.zeros(len(b.points), 3, dtype=torch.float64)) for b in (lying, turned))
        assert found[:3].tolist() == pytest.approx(expected[:3].tolist(), rel=0.02)


def test_edge_grows_with_the_volume():
    assert mesh_edge(egg((0.3, 0.1, 0.1))) == FINEST
    assert mesh_edge(egg((0.95, 0.95, 0.95))) == pytest.approx(
        (2 * 4 / 3 * np.pi * 0.95**3 / MOST_NODES) ** (1 / 3), rel=0.02
    )

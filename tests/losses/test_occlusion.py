"""Shadows in the image against shapes whose shadows are known."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from genmf_mi.losses.occlusion import Lamps, lamp, sky, visibility

PIXEL = 0.01
UP = torch.tensor([0.0, 0.0, 1.0])


def seen_from_the_front(height: np.ndarray) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Depth, normals and mask of a height field ``[H,W]`` that the camera looks at from far away."""
    down, right = np.gradient(height, PIXEL)
    normal = np.stack([-right, down, np.ones_like(height)])
    normal /= np.linalg.norm(normal, axis=0)
    to = lambda x: torch.tensor(x, dtype=torch.float64)[None]  # noqa: E731
    return to(4 - height)[None], to(normal), torch.ones(1, 1, *height.shape, dtype=torch.float64)


def unit(*direction: float) -> torch.Tensor:
    return torch.nn.functional.normalize(torch.tensor(direction, dtype=torch.float64), dim=0)


class TestLamp:
    def test_open_ground_sees_all_of_it(self):
        depth, _, _ = seen_from_the_front(np.zeros((40, 40)))
        assert lamp(depth, unit(1, 0, 1), PIXEL, 0.2).min() > 0.99

    @pytest.mark.parametrize("turn", range(4))
    def test_a_wall_casts_a_shadow_of_its_height(self, turn):
        """Light at 45° from the right, a wall of 0.05: the ground is dark for as far on its left."""
        height = np.zeros((41, 81))
        height[:, 40:] = 0.05
        direction = np.array([1.0, 0.0])
        height = np.rot90(height, turn)
        for _ in range(turn):  # anticlockwise, y up
            direction = np.array([-direction[1], direction[0]])
        depth, _, _ = seen_from_the_front(height)
        seen = lamp(depth, unit(*direction, 1), PIXEL, 0.08)[0, 0].numpy()
        line = np.rot90(seen, -turn)[20]
        assert line[37:40].max() < 0.3  # close to its foot
        assert line[32] > 0.8  # 0.075 away
        assert line[:28].min() > 0.95 and line[45:].min() > 0.95

    def test_half_of_the_lamp_where_the_ray_touches_the_edge(self):
        """A step as high as a pixel is wide, and light at 45°."""
        height = np.zeros((9, 60))
        height[:, 30:] = PIXEL
        depth, _, _ = seen_from_the_front(height)
        assert float(lamp(depth, unit(1, 0, 1), PIXEL, 0.08)[0, 0, 4, 29]) == pytest.approx(0.5, abs=0.01)


class TestSky:
    def test_a_plane_sees_all_of_it_however_it_is_tilted(self):
        x, y = np.meshgrid(np.arange(40) * PIXEL, np.arange(40) * PIXEL)
        for a, b in ((0, 0), (0.8, 0), (0.3, -0.6)):
            depth, normal, _ = seen_from_the_front(a * x + b * y)
            assert sky(depth, normal, PIXEL, 0.1)[..., 12:-12, 12:-12].min() > 0.999

    def test_the_bottom_of_a_groove_sees_less_than_its_rim_and_a_ridge_all(self):
        x = (np.arange(81) - 40) * PIXEL
        groove = np.broadcast_to(-0.1 * np.exp(-((x / 0.05) ** 2)), (41, 81))
        depth, normal, _ = seen_from_the_front(np.ascontiguousarray(groove))
        seen = sky(depth, normal, PIXEL, 0.2)[0, 0, 20].numpy()
        assert seen[40] < 0.85 and seen[20] > 0.99
        depth, normal, _ = seen_from_the_front(np.ascontiguousarray(-groove))
        assert sky(depth, normal, PIXEL, 0.2)[0, 0, 20, 40] > 0.99


class TestVisibility:
    LAMPS = Lamps(torch.stack([unit(-0.4, 0.5, 1), unit(0.8, 0.1, 0.6)]), (0.5, 0.2), 0.3)

    def test_outside_nothing_changes(self):
        depth, normal, mask = seen_from_the_front(np.zeros((30, 30)))
        mask[..., :10] = 0
        share = visibility(depth * mask, normal * mask, mask, self.LAMPS, PIXEL, 0.1)
        assert (share[..., :10] == 1).all()
        assert share[..., 2:-2, 14:-2].min() > 0.95  # the far background behind the rim casts no shadow

    def test_gradient(self):
        """With respect to the depth, against central differences."""
        rng = np.random.default_rng(0)
        height = 0.02 * rng.normal(size=(16, 16))
        depth, normal, mask = seen_from_the_front(height)
        depth.requires_grad_()
        weight = torch.tensor(rng.normal(size=(1, 1, 16, 16)))

        def value(d: torch.Tensor) -> torch.Tensor:
            return (visibility(d, normal, mask, self.LAMPS, PIXEL, 0.05) * weight).sum()

        (gradient,) = torch.autograd.grad(value(depth), depth)
        direction = torch.tensor(rng.normal(size=(1, 1, 16, 16)))
        step = 1e-7
        with torch.no_grad():
            expected = (value(depth + step * direction) - value(depth - step * direction)) / (2 * step)
        assert float((gradient * direction).sum()) == pytest.approx(float(expected), rel=1e-3)

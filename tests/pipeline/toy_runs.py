"""What the tests of whole refinements share: a small painted shape, settings for a few iterations, a recorder."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
import trimesh
from toys import stripes

import genmf_mi
from genmf_mi.assets.asset import Asset
from genmf_mi.core.progress import Progress
from genmf_mi.stress.fem.simulation import Settings

CONFIG = genmf_mi.RefineConfig(iterations=6, resolution=96, samples=4, max_faces=6000, edge_mm=3.0, score_vgg=False,
                               stress=False, learning_rate=0.0125, device="cpu")  # fmt: skip
TOLERANCE_MM = 2e-3
"""Between two runs with the same seed. Sums over faces and pixels are taken in any order, so that the last bits of the
gradients differ, and Adam divides small gradients by their own size."""

COARSE_STRESS = "genmf_mi.stress.fem.body_mesh.FINEST", 0.2
"""What to replace, and by what, for meshes of some hundred nodes."""


def ellipsoid() -> tuple[np.ndarray, np.ndarray]:
    ball = trimesh.creation.icosphere(4)
    return np.array(ball.vertices) * (1, 0.8, 0.9), np.array(ball.faces)


def striped_ellipsoid() -> Asset:
    vertices, faces = ellipsoid()
    return Asset.from_arrays("toy", vertices, faces, colours=stripes(vertices))


class Recorder(Progress):
    """Remembers what it is told, and raises ``error`` after ``stop`` iterations."""

    def __init__(self, stop: int | None = None, error: type[BaseException] = KeyboardInterrupt) -> None:
        self.stages: list[str] = []
        self.records: list[tuple[float, float, dict]] = []
        self.warnings: list[str] = []
        self.stop, self.error = stop, error

    def stage(self, name: str) -> None:
        self.stages.append(name)

    def advance(self, done: float, total: float, values: Mapping[str, float] | None = None) -> None:
        if values is not None:
            self.records.append((done, total, dict(values)))
            if done == self.stop:
                raise self.error

    def warn(self, message: str) -> None:
        self.warnings.append(message)


def difference_mm(one, other) -> float:
    """Between corresponding vertices, at most."""
    assert np.array_equal(one.faces, other.faces)
    scale = 100 / np.ptp(one.vertices, axis=0).max()
    return float(np.linalg.norm(one.vertices - other.vertices, axis=1).max() * scale)


class Waves:
    """In place of the predictor: a stress that is high in stripes across x, whatever the shape."""

    evaluations = 0
    asked: Settings | None = None

    def __init__(self, device: str = "cpu", settings: Settings | None = None) -> None:
        Waves.asked, self.settings, self.note = settings, Settings(grid=33), ""

    def field(self, phi: torch.Tensor, box: tuple[slice, slice, slice]) -> torch.Tensor:
        Waves.evaluations += 1
        waves = 1 + 0.5 * torch.sin(8 * torch.linspace(-1, 1, 33))
        return waves[:, None, None].expand(phi.shape)

"""The first picture of a run: what the part looks like so far, while the optimiser is still at work."""

from __future__ import annotations

from pathlib import Path

import torch
from PIL.Image import Image
from torch import Tensor

from genmf_mi.pipeline.evaluator import SEED, Evaluator
from genmf_mi.pipeline.surface import InitialSurface
from genmf_mi.render import bridge
from genmf_mi.report.pictures import compose, plastic, write_row

SAMPLES = 8
NAMES = "textured model", "printed as it is", "so far"


class Preview:
    """``preview.png`` of one standard view, the one in which the textured object has the most contrast.

    Args:
        path: of the picture. surface: of the part before its refinement.
    """

    def __init__(self, path: Path, evaluator: Evaluator, surface: InitialSurface) -> None:
        self._path, self._evaluator = path, evaluator
        index = evaluator.scorer.most_telling
        self._view = evaluator.views[index]
        colour = evaluator.render_colour([self._view], SAMPLES)[0]
        before = self._render(
            torch.as_tensor(surface.vertices, dtype=torch.float32, device=evaluator.device),
            torch.as_tensor(surface.faces, device=evaluator.device),
        )
        self._panels = (compose(colour, evaluator.mask[index, 0].cpu().numpy()), before)

    def update(self, vertices: Tensor, faces: Tensor | None = None) -> None:
        """Show the part as it is now; arguments as for :func:`bridge.render`. Raises :class:`OutputError`."""
        write_row(self._path, (*self._panels, self._render(vertices, faces)), NAMES)

    @torch.no_grad()
    def _render(self, vertices: Tensor, faces: Tensor | None) -> Image:
        part = bridge.render(self._evaluator.scene, [self._view], vertices, faces, seed=SEED, samples=SAMPLES)
        coverage = part.geometry[2]
        return compose(plastic(part.grey[0, 0].cpu().numpy()), coverage[0, 0].cpu().numpy())

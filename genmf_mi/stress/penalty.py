"""Predicted stress as a term of a refinement's loss: looked at every few iterations, its gradient held in between.

The field is a smooth function of a shape that moves by hundredths of a millimetre per iteration, and costs as much as
several renders.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from genmf_mi.losses import stress as losses
from genmf_mi.stress.model.network import window
from genmf_mi.stress.model.predictor import Predictor
from genmf_mi.stress.training.metrics import BAND


class StressPenalty:
    """L_stress of a shape that is being refined, relative to the shape that it starts from.

    Args:
        predictor: tells the field.
        distance: from the shape to Φ ``[1,n,n,n]``, differentiable: :class:`genmf_mi.geometry.mesh_distance.MeshDistance`
            for the vertices of a mesh, the identity where the shape is Φ itself.
        initial: the shape before its refinement, any tensor.
        every: calls per look at the field.
    """

    def __init__(self, predictor: Predictor, distance: Callable[[Tensor], Tensor], initial: Tensor, every: int) -> None:
        self.predictor, self.distance, self.every = predictor, distance, every
        with torch.no_grad():
            phi = distance(initial)
            # One window for all looks, as the field jumps a little where it does
            self.box = window(phi)
            self.initial = self._measures(phi)
        self._calls = 0

    def __call__(self, shape: Tensor) -> tuple[Tensor, dict[str, float]]:
        """L_stress of ``shape``, 0 for the initial one, and each term as of the last look, over that of the initial
        shape.

        The scalar is linear in the shape between two looks.
        """
        if self._calls % self.every == 0:
            self._look(shape)
        self._calls += 1
        return self._loss + (self._gradient * (shape - self._anchor)).sum(), self._terms

    def _look(self, shape: Tensor) -> None:
        self._anchor = shape.detach().clone()
        moving = self._anchor.clone().requires_grad_()
        relative = {name: value / self.initial[name] for name, value in self._measures(self.distance(moving)).items()}
        loss = sum(value - 1 for value in relative.values())
        (self._gradient,) = torch.autograd.grad(loss, moving)
        self._loss, self._terms = loss.detach(), {name: float(value.detach()) for name, value in relative.items()}

    def _measures(self, phi: Tensor) -> dict[str, Tensor]:
        """E and Var over the body, E over its surface band, and the peak; MPa and MPa²."""
        field = self.predictor.field(phi, self.box)
        body, band = losses.body(phi), losses.band(phi, BAND)
        return {
            "stress_mean": losses.mean(field, body),
            "stress_variance": losses.variance(field, body),
            "stress_band": losses.mean(field, band),
            "stress_peak": losses.peak(field, body),
        }

"""Predicted stress as a term of the loss: evaluated every few iterations, linear in between.

The field is a smooth function of a shape that moves by hundredths of a millimetre per iteration, and costs as much as
several renders.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from genmf_mi.core.config import Weights
from genmf_mi.losses import stress as losses
from genmf_mi.losses.objective import weighted_sum
from genmf_mi.stress.model.network import crop_box
from genmf_mi.stress.model.predictor import Predictor

TERMS = ("stress_mean", "stress_variance", "stress_band", "stress_peak")
"""E and Var over the body, E over its surface band, and the peak (E σ⁸)^⅛."""


class StressPenalty:
    """L_stress = Σ λ (L / L₀ − 1): each term relative to the initial shape, so that the penalty of that one is 0.

    Between two evaluations the penalty is its tangent at the last one.

    Args:
        predictor: of the field.
        distance: from the shape to Φ ``[1,n,n,n]``, differentiable.
        initial: the shape before its refinement, any tensor.
        every: calls per evaluation of the field.
        band: depth of the surface band, in the unit of Φ.
        weights: λ of the terms; those without a weight are reported only.
    """

    def __init__(
        self,
        predictor: Predictor,
        distance: Callable[[Tensor], Tensor],
        initial: Tensor,
        *,
        every: int,
        band: float,
        weights: Weights | None = None,
    ) -> None:
        self._predictor, self._distance, self._every, self._band = predictor, distance, every, band
        self._weights = {name: getattr(weights or Weights(), name) for name in TERMS}
        with torch.no_grad():
            phi = distance(initial)
            # One crop for all evaluations, as the field of a network changes a little with it
            self._crop = crop_box(phi)
            self._initial = self._measures(phi)
        self._calls = 0
        self._tangent: dict[str, Tensor] = {}
        self._terms: dict[str, float] = {}

    def __call__(self, shape: Tensor) -> tuple[Tensor, dict[str, float]]:
        """L_stress of ``shape``, and each L / L₀ as of the last evaluation."""
        if self._calls % self._every == 0:
            self._evaluate(shape)
        self._calls += 1
        value, at, gradient = (self._tangent[name] for name in ("value", "at", "gradient"))
        return value + (gradient * (shape - at)).sum(), self._terms

    def state_dict(self) -> dict[str, Any]:
        """All that the following calls depend on."""
        return {"calls": self._calls, "tangent": dict(self._tangent), "terms": dict(self._terms)}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from a :meth:`state_dict`."""
        self._calls, self._terms = state["calls"], dict(state["terms"])
        self._tangent = {
            name: value.to(self._initial["stress_mean"].device) for name, value in state["tangent"].items()
        }

    def _evaluate(self, shape: Tensor) -> None:
        at = shape.detach().clone()
        moving = at.clone().requires_grad_()
        relative = {name: value / self._initial[name] for name, value in self._measures(self._distance(moving)).items()}
        value = weighted_sum({name: ratio - 1 for name, ratio in relative.items()}, self._weights)
        (gradient,) = torch.autograd.grad(value, moving)
        self._tangent = {"value": value.detach(), "at": at, "gradient": gradient}
        self._terms = {name: float(ratio.detach()) for name, ratio in relative.items()}

    def _measures(self, phi: Tensor) -> dict[str, Tensor]:
        """The :data:`TERMS` in MPa, the variance in MPa²."""
        field = self._predictor.field(phi, self._crop)
        body, band = losses.body(phi), losses.band(phi, self._band)
        measures = losses.mean(field, body), losses.variance(field, body), losses.mean(field, band)
        return dict(zip(TERMS, (*measures, losses.peak(field, body)), strict=True))

"""Predicted stress as a term of the loss: evaluated every few iterations, linear in between.

The field is a smooth function of a shape that moves by hundredths of a millimetre per iteration, and costs as much as
several renders. Only what relief adds to the stress counts, and only relief can be taken away for it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from genmf_mi.core.config import Weights
from genmf_mi.losses import stress as losses
from genmf_mi.stress.fem.following import MEASURES, FollowingBody
from genmf_mi.stress.model.network import crop_box
from genmf_mi.stress.model.predictor import Predictor

Measure = Callable[[Tensor], Tensor]
"""From a shape to the :data:`MEASURES` of its stress ``[4]``, differentiable."""
FREE, TOLERATED = 0.02, 0.05
"""Increase of a measure over that of the initial shape up to which it does not count, as finer elements find half of it
only, and from which on it counts fully."""
VARIANCE = MEASURES.index("stress_variance")


def by_solver(body: FollowingBody, follow: Callable[[Tensor], Tensor]) -> Measure:
    """Finite elements on one mesh. follow: from the shape to the motion ``[N,3]`` of ``body.points``."""
    return lambda shape: body.measures(follow(shape))


def by_network(predictor: Predictor, distance: Callable[[Tensor], Tensor], initial: Tensor, band: float) -> Measure:
    """A coarse field with the network's correction.

    distance: from the shape to Φ ``[1,n,n,n]``, differentiable. initial: the shape before its refinement.
    band: depth of the surface band, in the unit of Φ.
    """
    with torch.no_grad():
        # One crop for all evaluations, as the field of a network changes a little with it
        crop = crop_box(distance(initial))

    def measure(shape: Tensor) -> Tensor:
        phi = distance(shape)
        field, body = predictor.field(phi, crop), losses.body(phi)
        near = losses.mean(field, losses.band(phi, band))
        return torch.stack([losses.mean(field, body), losses.variance(field, body), near, losses.peak(field, body)])

    return measure


class StressPenalty:
    """L_stress = Σ λ h(L / L₀ − 1): each measure relative to the initial shape, of the variance its root. h is 0 up to
    the free increase, and its slope grows from there to 1 at the tolerated one. Between two evaluations the penalty is
    linear.

    Its gradient is projected on less relief: a vertex is drawn back towards where it was, or, of a field, a value
    towards what it was, or not at all. What has not moved stays.

    Args:
        measure: of a shape. initial: the shape before its refinement, any tensor.
        every: calls per evaluation.
        weights: λ of the measures; those without a weight are reported only.
    """

    def __init__(self, measure: Measure, initial: Tensor, *, every: int, weights: Weights | None = None) -> None:
        self._measure, self._every, self._initial = measure, every, initial.detach().clone()
        self._weights = torch.tensor([getattr(weights or Weights(), name) for name in MEASURES]).to(initial)
        with torch.no_grad():
            self._before = measure(self._initial)
        self._calls = 0
        self._tangent: dict[str, Tensor] = {}
        self._ratios: dict[str, float] = {}

    def __call__(self, shape: Tensor) -> tuple[Tensor, dict[str, float]]:
        """L_stress of ``shape``, and each L / L₀ as of the last evaluation."""
        if self._calls % self._every == 0:
            self._evaluate(shape)
        self._calls += 1
        value, at, gradient = (self._tangent[name] for name in ("value", "at", "gradient"))
        return value + (gradient * (shape - at)).sum(), self._ratios

    @property
    def strength(self) -> float:
        """The largest slope of h as of the last evaluation: 1 where a measure is above the tolerated increase, 0 where
        none has increased."""
        return float(self._tangent["strength"])

    def state_dict(self) -> dict[str, Any]:
        """All that the following calls depend on."""
        return {"calls": self._calls, "tangent": dict(self._tangent), "ratios": dict(self._ratios)}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from a :meth:`state_dict`. Raises :class:`ValueError` for one of another shape, or that is none."""
        tangent = {name: value.to(self._initial.device) for name, value in state["tangent"].items()}
        whole = {"value", "at", "gradient", "strength"} <= set(tangent) or not state["calls"]
        fits = all(tangent[name].shape == self._initial.shape for name in ("at", "gradient") if name in tangent)
        if not (isinstance(state["calls"], int) and whole and fits):
            raise ValueError("no state of this stress penalty")
        self._calls, self._ratios, self._tangent = state["calls"], dict(state["ratios"]), tangent

    def _evaluate(self, shape: Tensor) -> None:
        at = shape.detach().clone()
        moving = at.clone().requires_grad_()
        ratios = self._measure(moving) / self._before
        roots = torch.where(torch.arange(len(ratios), device=ratios.device) == VARIANCE, ratios.sqrt(), ratios)
        penalties, slopes = hinge(roots.detach() - 1)
        value = (self._weights * penalties).sum()
        gradient = torch.zeros_like(at)
        if bool((self._weights * slopes).any()):
            (gradient,) = torch.autograd.grad((self._weights * slopes * roots).sum(), moving)
        gradient = towards(self._initial, at, gradient)
        self._tangent = {"value": value, "at": at, "gradient": gradient, "strength": slopes.max()}
        self._ratios = dict(zip(MEASURES, ratios.tolist(), strict=True))


def hinge(increase: Tensor) -> tuple[Tensor, Tensor]:
    """h and its slope: 0 below :data:`FREE`, a parabola up to :data:`TOLERATED`, and straight from there on."""
    excess, width = (increase - FREE).clamp_min(0), TOLERATED - FREE
    slope = (excess / width).clamp_max(1)
    return torch.where(excess < width, excess * slope / 2, excess - width / 2), slope


def towards(initial: Tensor, shape: Tensor, gradient: Tensor) -> Tensor:
    """The part of a gradient along which a step leads from ``shape`` back to ``initial``: of vertices ``[V,3]`` the
    component along their offset, of values on a grid each, where a step against it makes the offset smaller."""
    offset = shape - initial
    if shape.dim() == 2:
        along = (gradient * offset).sum(dim=1, keepdim=True).clamp_min(0)
        return along * offset / offset.square().sum(dim=1, keepdim=True).clamp_min(1e-20)
    return torch.where(gradient * offset > 0, gradient, torch.zeros_like(gradient))

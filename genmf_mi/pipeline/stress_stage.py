"""The second stage of a refinement: predicted thermal stress joins the loss."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from genmf_mi.core.config import RefineConfig
from genmf_mi.core.progress import Progress
from genmf_mi.geometry.parameterization import Geometry, Parameterization
from genmf_mi.geometry.uniform_adam import UniformAdam, percentile
from genmf_mi.pipeline.problem import DIRECTIONS, RefinementProblem
from genmf_mi.sdf import distance
from genmf_mi.stress.fem.simulation import Settings
from genmf_mi.stress.fem.statistics import surface_band_depth
from genmf_mi.stress.model import predictor
from genmf_mi.stress.penalty import StressPenalty

LARGEST_THIN_SHARE = 0.1
"""Share of the surface under which a part may be thinner than two cells of the grid and have a stress stage. Walls that
the grid loses seem free of stress, so that they would be thinned still more."""


def too_thin(problem: RefinementProblem) -> str:
    """Why a part cannot have a stress stage, as part of a sentence; empty if it can."""
    surface = problem.surface.vertices, problem.surface.faces
    share = distance.thin_fraction(*surface, distance.signed_distance(*surface, Settings().grid))
    reason = f"walls are too thin to predict their stress under {share:.0%} of the surface: print it larger"
    return reason * (share > LARGEST_THIN_SHARE)


def not_upright(problem: RefinementProblem) -> str:
    """Why the network cannot predict the stress of a part that does not stand upright, empty if it does."""
    return "the network knows parts that are printed upright only" * (problem.frame.up != DIRECTIONS["upright"])


def plan(
    problem: RefinementProblem, config: RefineConfig, device: str, progress: Progress
) -> tuple[StressStage | None, str]:
    """The stage that a run will have, or else None and why the part cannot have the one that was asked for."""
    if not config.stress_stage or config.method != "relief":
        return None, ""
    left_out = too_thin(problem) or not_upright(problem)
    if left_out:
        progress.warn(f"no stress stage: {left_out}")
        return None, left_out
    return StressStage(config, device, progress), ""


class StressStage:
    """Adds L_stress to the loss from iteration ``first`` on.

    Args:
        device: of the network. progress: is warned if the network was not trained for such a part.
    """

    def __init__(self, config: RefineConfig, device: str, progress: Progress) -> None:
        self.first = config.stage_one_share * config.iterations
        self._config, self._device, self._progress = config, device, progress
        self._penalty: StressPenalty | None = None
        self._gradient_norm_weight = 0.0

    def begin(self, parameterization: Parameterization) -> None:
        """Predict the stress of the initial shape."""
        part = Settings(size_mm=self._config.size_mm, material=self._config.material)
        prediction = predictor.Predictor(device=self._device, settings=part)
        if prediction.note:
            self._progress.warn(prediction.note)
        self._penalty = StressPenalty(
            prediction,
            parameterization.distance(prediction.settings.grid),
            parameterization.initial_shape,
            every=self._config.stress_every,
            band=surface_band_depth(self._config.size_mm),
            weights=self._config.weights,
        )

    def term(
        self, geometry: Geometry, parameter: Tensor, optimiser: UniformAdam
    ) -> tuple[Tensor, float, dict[str, float]]:
        """L_stress, its weight, and the stress terms relative to the initial shape.

        The weight is ``stress_weight`` times a factor that makes the gradient of L_stress with respect to ``parameter``
        as large as those of the appearance were at the end of stage one, so that one setting serves all objects.
        """
        assert self._penalty is not None, "the stage has not begun"
        penalty, terms = self._penalty(geometry.shape)
        if not self._gradient_norm_weight:
            (gradient,) = torch.autograd.grad(penalty, parameter, retain_graph=True)
            self._gradient_norm_weight = optimiser.scale / max(float(percentile(gradient.abs(), 0.99)), 1e-12)
        return penalty, self._config.stress_weight * self._gradient_norm_weight, terms

    def state_dict(self) -> dict[str, Any]:
        """All that the following iterations depend on; empty before the stage has begun."""
        if self._penalty is None:
            return {}
        return {"gradient_norm_weight": self._gradient_norm_weight, "penalty": self._penalty.state_dict()}

    def load_state_dict(self, state: dict[str, Any], parameterization: Parameterization) -> None:
        """Continue from a :meth:`state_dict`."""
        if not state:
            self._penalty, self._gradient_norm_weight = None, 0.0
            return
        if self._penalty is None:
            self.begin(parameterization)
        assert self._penalty is not None
        self._gradient_norm_weight = state["gradient_norm_weight"]
        self._penalty.load_state_dict(state["penalty"])

    @property
    def begun(self) -> bool:
        return self._penalty is not None

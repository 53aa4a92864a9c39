"""The second stage of a refinement: what relief adds to the thermal stress joins the loss."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from genmf_mi.core.config import RefineConfig
from genmf_mi.core.errors import SolidError
from genmf_mi.core.frame import UPRIGHT, Frame
from genmf_mi.core.progress import Progress
from genmf_mi.geometry.parameterization import Geometry, Parameterization
from genmf_mi.geometry.uniform_adam import UniformAdam, percentile
from genmf_mi.pipeline.problem import RefinementProblem
from genmf_mi.sdf import distance
from genmf_mi.stress.fem.following import FollowingBody
from genmf_mi.stress.fem.linear import SolveError
from genmf_mi.stress.fem.settings import Settings
from genmf_mi.stress.fem.statistics import surface_band_depth
from genmf_mi.stress.model import predictor
from genmf_mi.stress.penalty import Measure, StressPenalty, by_network, by_solver

LARGEST_THIN_SHARE = 0.1
"""Share of the surface under which a part may be thinner than two cells of the grid and have a stress stage. Walls that
the grid loses seem free of stress, so that they would be thinned still more."""


def too_thin(thin_share: float) -> str:
    """Why a part cannot have a stress stage, as part of a sentence; empty if it can."""
    reason = f"walls are too thin to predict their stress under {thin_share:.0%} of the surface: print it larger"
    return reason * (thin_share > LARGEST_THIN_SHARE)


def not_upright(frame: Frame, config: RefineConfig) -> str:
    """Why the network cannot predict the stress of a part that does not stand upright, empty if it can."""
    unknown = config.stress_by == "network" and frame.up != UPRIGHT
    return "the network knows parts that are printed upright only: use --stress-by solver" * unknown


def plan(
    problem: RefinementProblem,
    parameterization: Parameterization,
    config: RefineConfig,
    device: str,
    progress: Progress,
) -> tuple[StressStage | None, str]:
    """The stage that a run will have, or else None and why the part cannot have the one that was asked for."""
    if not config.stress_stage or config.method != "relief":
        return None, ""
    progress.stage("meshing for the stress")
    surface = problem.surface.vertices, problem.surface.faces
    phi = distance.signed_distance(*surface, Settings().grid)
    left_out, measure = too_thin(distance.thin_fraction(*surface, phi)) or not_upright(problem.frame, config), None
    if not left_out:
        part = Settings(size_mm=config.size_mm, material=config.material)
        try:
            if config.stress_by == "solver":
                body = FollowingBody(phi, problem.frame, part)
                measure = by_solver(body, parameterization.follow(body.points, body.reach))
            else:
                prediction = predictor.Predictor(device=device, settings=part)
                if prediction.note:
                    progress.warn(prediction.note)
                distance_of, band = (
                    parameterization.distance(prediction.settings.grid),
                    surface_band_depth(part.size_mm),
                )
                measure = by_network(prediction, distance_of, parameterization.initial_shape, band)
        except (SolidError, SolveError) as error:
            left_out = str(error)
    if measure is None:
        progress.warn(f"no stress stage: {left_out}")
        return None, left_out
    return StressStage(measure, config), ""


class StressStage:
    """Adds L_stress to the loss from iteration ``first`` on."""

    def __init__(self, measure: Measure, config: RefineConfig) -> None:
        self.first = config.stage_one_share * config.iterations
        self._measure, self._config = measure, config
        self._penalty: StressPenalty | None = None
        self._gradient_norm_weight = 0.0

    def begin(self, parameterization: Parameterization) -> None:
        """Compute the stress of the initial shape."""
        config, initial = self._config, parameterization.initial_shape
        self._penalty = StressPenalty(self._measure, initial, every=config.stress_every, weights=config.weights)

    def term(
        self, geometry: Geometry, parameter: Tensor, optimiser: UniformAdam
    ) -> tuple[Tensor, float, dict[str, float]]:
        """L_stress, its weight, and the measures of the stress relative to the initial shape.

        The weight is ``stress_weight`` times a factor, found at the first evaluation that sees relief raise the stress:
        at the tolerated increase or more, the gradient of L_stress with respect to ``parameter`` is then as large as
        those of the appearance were, so that one setting serves all objects.
        """
        assert self._penalty is not None, "the stage has not begun"
        penalty, terms = self._penalty(geometry.shape)
        strength = self._penalty.strength
        if strength and not self._gradient_norm_weight:
            (gradient,) = torch.autograd.grad(penalty, parameter, retain_graph=True)
            largest = float(percentile(gradient.abs(), 0.99))
            self._gradient_norm_weight = strength * optimiser.scale / max(largest, 1e-12)
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

"""Losses on the predicted thermal stress (GenMF, section on structural robustness).

Fields are ``[1,X,Y,Z]`` on the grid [-1, 1]³: ``stress`` in MPa, ``phi`` in normalised units, negative inside.

The paper takes E and Var over the samples with Φ ≤ 0. A sample here counts by how far it is inside, from nothing at the
surface to all of it at :data:`RAMP_CELLS` below: a hard edge would make the losses jump whenever the surface passes a
sample, and would leave out of the derivatives that the body itself changes.
"""

from __future__ import annotations

from typing import TypeAlias

from jaxtyping import Float
from torch import Tensor

from genmf_mi.losses.shapes import Field, Scalar

Samples: TypeAlias = Float[Tensor, "*samples"]
"""One value for each sample of a grid, or for each cell of a mesh."""

RAMP_CELLS = 0.5
"""Grid cells over which the weight of a sample rises from 0 to 1."""


def mean(stress: Samples, weight: Samples) -> Scalar:
    """L_stress-avg = E(σ), a scalar in MPa; ``weight`` from :func:`body` or :func:`band`, or volumes of cells."""
    return (weight * stress).sum() / weight.sum()


def variance(stress: Samples, weight: Samples) -> Scalar:
    """L_stress-var = Var(σ), a scalar in MPa²."""
    return mean((stress - mean(stress, weight)).square(), weight)


def peak(stress: Samples, weight: Samples, power: float = 8.0) -> Scalar:
    """A smooth stand-in for the maximum, (E σᵖ)^(1/p) in MPa: the place that breaks first
    hardly shows in Var. Not in the paper."""
    highest = stress.detach().max().clamp_min(1e-6)
    return highest * mean((stress / highest).clamp_min(0).pow(power), weight).pow(1 / power)


def body(phi: Field) -> Field:
    """Weight of each sample in averages over the whole body, 0..1."""
    return (-phi / (RAMP_CELLS * _cell(phi))).clamp(0, 1)


def band(phi: Field, depth: float) -> Field:
    """Weight of each sample in averages over the layer within ``depth`` (normalised units) of the surface, 0..1."""
    return body(phi) * (0.5 + (phi + depth) / _cell(phi)).clamp(0, 1)


def _cell(phi: Field) -> float:
    return 2.0 / (phi.shape[-1] - 1)

"""What keeps thermal stress down (GenMF, section on structural robustness).

Fields are ``[1,X,Y,Z]`` on the grid [-1, 1]³: ``stress`` in MPa, ``phi`` in normalised units, negative inside.

The paper takes E and Var over the samples with Φ ≤ 0. A sample here counts by how far it is inside, from nothing at the
surface to all of it at :data:`RAMP_CELLS` below: a hard edge would make the losses jump whenever the surface passes a
sample, and would hide from the derivatives that the body itself changes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from torch import Tensor

RAMP_CELLS = 0.5
"""Grid cells over which a sample comes to count."""


def mean(stress: Tensor, weight: Tensor) -> Tensor:
    """L_stress-avg = E(σ), a scalar in MPa; ``weight`` from :func:`body` or :func:`band`."""
    return (weight * stress).sum() / weight.sum()


def variance(stress: Tensor, weight: Tensor) -> Tensor:
    """L_stress-var = Var(σ), a scalar in MPa²."""
    return mean((stress - mean(stress, weight)).square(), weight)


def peak(stress: Tensor, weight: Tensor, power: float = 8.0) -> Tensor:
    """A smooth stand-in for the maximum, (E σᵖ)^(1/p) in MPa: what Var sees last is what breaks first. Not in the
    paper."""
    highest = stress.detach().max().clamp_min(1e-6)
    return highest * mean((stress / highest).clamp_min(0).pow(power), weight).pow(1 / power)


def body(phi: Tensor) -> Tensor:
    """How much each sample counts for the whole body, 0..1."""
    return (-phi / (RAMP_CELLS * _cell(phi))).clamp(0, 1)


def band(phi: Tensor, depth: float) -> Tensor:
    """How much each sample counts for the layer within ``depth`` (normalised units) of the surface, 0..1."""
    return body(phi) * (0.5 + (phi + depth) / _cell(phi)).clamp(0, 1)


def _cell(phi: Tensor) -> float:
    return 2.0 / (phi.shape[-1] - 1)

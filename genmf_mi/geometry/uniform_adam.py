"""Adam with one step size for a whole surface."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

CLIP = 10.0
"""Entries of a gradient are clipped at this many times its 99th percentile."""


@dataclass
class Moments:
    """Of the gradient of one parameter: running means of it and of its square, how many steps they are of, and the
    scale of the last."""

    first: Tensor
    second: Tensor
    step: int = 0
    scale: float = 0.0


class UniformAdam:
    """Adam whose step is scaled by one number per parameter (Nicolet et al. 2021), made robust.

    The scale is the 99th percentile of the root second moments instead of their maximum, and single entries of the
    gradient are clipped at ten times that percentile: a vertex on a silhouette, whose gradient is a spike, must neither
    jump nor slow down all others. Entries that are not finite count as 0; their number is kept in ``nonfinite``.

    It is no ``torch.optim.Optimizer``, whose constructor loads torch's compiler: a second, and 100 MB.

    Args:
        parameters: leaf tensors, each with a scale of its own.
        rate: learning rate, of all parameters alike; ``rates`` has that of each and may be set before any step.
        betas: decay of the first and the second moment.
        floor: added to the scale. Gradients well below the floor move the surface in proportion; without it, round-off
            would be amplified to full steps.
    """

    def __init__(
        self, parameters: Iterable[Tensor], rate: float, *, betas: tuple[float, float] = (0.9, 0.99), floor: float = 0.0
    ) -> None:
        self._parameters, self._betas, self._floor = tuple(parameters), betas, floor
        self.rates = [rate] * len(self._parameters)
        self._moments = [Moments(torch.zeros_like(p), torch.zeros_like(p)) for p in self._parameters]
        self.nonfinite = 0

    @property
    def scale(self) -> float:
        """The root second moment by which the last step of the first parameter was divided; 0 before any step."""
        return self._moments[0].scale

    @torch.no_grad()
    def step(self) -> None:
        """Move the parameters along their gradients, and clear these."""
        self.nonfinite = 0
        beta1, beta2 = self._betas
        for parameter, rate, moments in zip(self._parameters, self.rates, self._moments, strict=True):
            gradient, parameter.grad = parameter.grad, None
            assert gradient is not None
            self.nonfinite += int((~torch.isfinite(gradient)).sum())
            gradient = torch.nan_to_num(gradient, nan=0.0, posinf=0.0, neginf=0.0)
            moments.step += 1
            limit = CLIP * percentile(gradient.abs(), 0.99)
            gradient.clamp_(-limit, limit)
            moments.first.mul_(beta1).add_(gradient, alpha=1 - beta1)
            moments.second.mul_(beta2).addcmul_(gradient, gradient, value=1 - beta2)
            scale = (percentile(moments.second, 0.99) / (1 - beta2**moments.step)).sqrt()
            update = moments.first / (1 - beta1**moments.step) / (scale + self._floor + 1e-20)
            parameter.sub_(update, alpha=rate)
            moments.scale = float(scale)

    def state_dict(self) -> dict[str, Any]:
        """All that the following steps depend on but for the parameters and the rates; not a copy."""
        return {"moments": [vars(moments) for moments in self._moments]}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from a copy of a :meth:`state_dict`, on the devices of the parameters.

        Raises:
            ValueError: it is of other parameters, or no state.
        """
        try:
            moments = [
                Moments(m["first"].to(p.device, copy=True), m["second"].to(p.device, copy=True), m["step"], m["scale"])
                for p, m in zip(self._parameters, state["moments"], strict=True)
            ]
        except (AttributeError, KeyError, TypeError, RuntimeError) as error:
            raise ValueError("no state of this optimiser") from error
        for p, m in zip(self._parameters, moments, strict=True):
            sound = m.first.shape == m.second.shape == p.shape and m.first.dtype == m.second.dtype == p.dtype
            counted = isinstance(m.step, int) and m.step >= 0 and isinstance(m.scale, float)
            if not (sound and counted and torch.isfinite(m.first).all() and torch.isfinite(m.second).all()):
                raise ValueError("no state of these parameters")
        self._moments = moments


def percentile(x: Tensor, share: float) -> Tensor:
    """The value that ``share`` of the entries of ``x`` do not exceed, a scalar."""
    flat = x.flatten()
    return flat.kthvalue(max(1, int(share * flat.numel()))).values

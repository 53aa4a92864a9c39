"""Adam with one step size for a whole surface."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import torch
from torch import Tensor

CLIP = 10.0
"""Entries of a gradient are clipped at this many times its 99th percentile."""


class UniformAdam(torch.optim.Optimizer):
    """Adam whose step is scaled by one number per parameter (Nicolet et al. 2021), made robust.

    The scale is the 99th percentile of the root second moments instead of their maximum, and single entries of the
    gradient are clipped at ten times that percentile: a vertex on a silhouette, whose gradient is a spike, must neither
    jump nor slow down all others. Entries that are not finite count as 0; their number is kept in ``nonfinite``.

    Args:
        params: leaf tensors; each has a scale and, through its parameter group, a learning rate of its own.
        lr: learning rate.
        betas: decay of the first and the second moment.
        floor: added to the scale. Gradients well below the floor move the surface in proportion; without it, round-off
            would be amplified to full steps.
    """

    def __init__(
        self, params: Iterable[Tensor], lr: float, *, betas: tuple[float, float] = (0.9, 0.99), floor: float = 0.0
    ) -> None:
        # A group each, so that the learning rates can be set one by one
        super().__init__([{"params": [p]} for p in params], {"lr": lr, "betas": betas, "floor": floor})
        self.nonfinite = 0

    @property
    def scale(self) -> float:
        """The root second moment by which the last step of the first parameter was divided; 0 before any step."""
        state = self.state.get(self.param_groups[0]["params"][0], {})
        return float(state.get("scale", 0.0))

    @torch.no_grad()
    def step(self, closure: Callable[[], float] | None = None) -> None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Move the parameters along their gradients, and clear these."""
        self.nonfinite = 0
        for group in self.param_groups:
            beta1, beta2 = group["betas"]
            for parameter in group["params"]:
                gradient = parameter.grad
                parameter.grad = None
                self.nonfinite += int((~torch.isfinite(gradient)).sum())
                gradient = torch.nan_to_num(gradient, nan=0.0, posinf=0.0, neginf=0.0)
                state = self.state[parameter]
                if not state:
                    state["step"] = 0
                    state["exp_avg"], state["exp_avg_sq"] = torch.zeros_like(parameter), torch.zeros_like(parameter)
                state["step"] += 1
                limit = CLIP * percentile(gradient.abs(), 0.99)
                gradient.clamp_(-limit, limit)
                state["exp_avg"].mul_(beta1).add_(gradient, alpha=1 - beta1)
                state["exp_avg_sq"].mul_(beta2).addcmul_(gradient, gradient, value=1 - beta2)
                scale = (percentile(state["exp_avg_sq"], 0.99) / (1 - beta2 ** state["step"])).sqrt()
                update = state["exp_avg"] / (1 - beta1 ** state["step"]) / (scale + group["floor"] + 1e-20)
                parameter.sub_(update, alpha=group["lr"])
                state["scale"] = float(scale)


def percentile(x: Tensor, share: float) -> Tensor:
    """The value that ``share`` of the entries of ``x`` do not exceed, a scalar."""
    flat = x.flatten()
    return flat.kthvalue(max(1, int(share * flat.numel()))).values

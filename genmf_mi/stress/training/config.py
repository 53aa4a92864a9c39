"""Settings of a training; without torch, so that the command line is built from them quickly."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from typing import Literal

from genmf_mi.core.errors import ConfigError


@dataclass(frozen=True)
class TrainConfig:
    """How the network is trained."""

    preset: Literal["compact", "direct", "paper"] = "compact"
    """compact (for a CPU too), direct (without a coarse mesh) or paper (for a GPU)."""
    steps: int = 8000
    """Steps of the optimiser at most."""
    minutes: float = 0.0
    """Wall time at most; the learning rate then falls with the clock, so no two runs are alike. 0: only steps count."""
    batch: int = 2
    """Samples per step."""
    rate: float = 1e-3
    """Highest learning rate; it rises to that over the first 2 % and falls to 0 along a cosine."""
    weight_decay: float = 1e-2
    """Of AdamW."""
    tail: float = 0.0
    """How much more the most stressed 5 % of a body count in the loss."""
    stride: int = 1
    """2 trains on every other sample of the grid, an eighth of the cost; relief is lost."""
    validate_every: int = 200
    """Steps between validations."""
    patience: int = 15
    """Validations without a better one after which the training ends."""
    start: str = ""
    """Weights to begin from, of the same network and protocol: its preset for those of the package, or a file; at
    random if not given."""
    seed: int = 0
    """Of weights, order and symmetries."""
    precision: Literal["auto", "float32", "bfloat16"] = "auto"
    """auto: bfloat16 where the device computes in it."""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """auto: CUDA where there is one."""

    def __post_init__(self) -> None:
        for name in ("steps", "batch", "stride", "validate_every", "patience"):
            if getattr(self, name) < 1:
                raise ConfigError(f"{name} must be at least 1, not {getattr(self, name)}.")
        for name in ("minutes", "weight_decay", "tail"):
            if not (isfinite(getattr(self, name)) and getattr(self, name) >= 0):
                raise ConfigError(f"{name} must not be negative: {getattr(self, name)}.")
        if not (isfinite(self.rate) and self.rate > 0):
            raise ConfigError(f"rate must be positive, not {self.rate}.")

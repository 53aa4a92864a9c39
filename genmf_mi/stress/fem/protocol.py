"""What is simulated: a printed part cools down on its bed in still air, and the stress is read on the way."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite

from genmf_mi.core.errors import ConfigError


@dataclass(frozen=True)
class Protocol:
    """Boundary conditions and times; see ``docs/stress.md`` for why each has the value it has.

    The part starts at the stress-free temperature of its material, everywhere. The ambient temperature falls from there
    to ``ambient_end_celsius`` linearly within ``ramp_s``; the field is recorded at ``record_s``, while the part is
    still warmer inside than outside. At equilibrium the field would come from the clamped base alone and would
    not depend on relief.
    """

    ambient_end_celsius: float = 25.0
    ramp_s: float = 1200.0
    record_s: float = 1200.0
    step_s: float = 60.0
    heat_transfer_coefficient_w_m2k: float = 5.0
    """Heat transfer coefficient of still air, on the whole surface."""
    clamp_fraction: float = 0.02
    """Height of the soft clamp at the base, as a fraction of the height of the part."""

    def __post_init__(self) -> None:
        if not isfinite(self.ambient_end_celsius) or self.ambient_end_celsius <= -273.15:
            raise ConfigError(f"ambient_end_celsius must be a temperature, not {self.ambient_end_celsius}.")
        for name in ("record_s", "step_s", "clamp_fraction"):
            if not (isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise ConfigError(f"{name} must be positive, not {getattr(self, name)}.")
        for name in ("ramp_s", "heat_transfer_coefficient_w_m2k"):
            if not (isfinite(getattr(self, name)) and getattr(self, name) >= 0):
                raise ConfigError(f"{name} must not be negative, and a number: {getattr(self, name)}.")
        if abs(self.steps * self.step_s - self.record_s) > 1e-6 * self.record_s:
            raise ConfigError(f"record_s ({self.record_s}) must be a multiple of step_s ({self.step_s}).")

    @property
    def steps(self) -> int:
        """Number of backward Euler steps until the field is recorded."""
        return max(1, round(self.record_s / self.step_s))

    @property
    def heat_transfer_coefficient_w_mm2k(self) -> float:
        return self.heat_transfer_coefficient_w_m2k * 1e-6

    def ambient(self, time_s: float, start_celsius: float) -> float:
        """T_amb(t) in °C, for a part that starts at ``start_celsius``."""
        done = 1.0 if self.ramp_s == 0 else min(1.0, time_s / self.ramp_s)
        return start_celsius + (self.ambient_end_celsius - start_celsius) * done

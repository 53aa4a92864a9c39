"""The settings of a simulation."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import isfinite

from genmf_mi.core.errors import ConfigError
from genmf_mi.stress.fem import materials
from genmf_mi.stress.fem.protocol import Protocol


@dataclass(frozen=True)
class Settings:
    """How a shape is simulated.

    Raises:
        ConfigError: a length that is not positive, an unknown material, or a grid too small to hold a shape.
    """

    size_mm: float = 100.0
    """Longest side of the part."""
    edge_mm: float = 1.6
    """Side of the lattice that the tetrahedra come from: 1.6 for training data, 1.2 or less to judge relief."""
    grid: int = 129
    """Samples per axis of Φ and of the field."""
    material: str = "pla"
    """A name in :data:`genmf_mi.stress.fem.materials.MATERIALS`."""
    protocol: Protocol = field(default_factory=Protocol)

    def __post_init__(self) -> None:
        for name in ("size_mm", "edge_mm"):
            if not (isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise ConfigError(f"{name} must be positive, not {getattr(self, name)}.")
        if self.grid < 17:
            raise ConfigError(f"grid must be at least 17 samples per axis, not {self.grid}.")
        materials.material(self.material)

"""The machine that a part is for, as far as the look and the soundness of the part depend on it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf
from typing import Literal

from genmf_mi.core.errors import ConfigError

PrinterName = Literal["smooth", "fdm-0.2", "fdm-0.12", "fdm-0.08", "resin"]
"""Names of the :data:`PRINTERS`."""


@dataclass(frozen=True)
class Printer:
    """A process and its settings; lengths in mm."""

    process: Literal["fdm", "resin", "smooth"]
    """Filament is a stack of beads that can be seen and felt; the layers of resin cannot; ``smooth`` is what is cast,
    or sanded and primed."""
    layer_mm: float = 0.2
    """Height of a layer."""
    line_width_mm: float = 0.45
    """Width of the outermost bead."""
    bulge: float = 0.5
    """How far the side of a bead bulges, in layer heights: slicers reckon with half a circle."""
    smallest_feature_mm: float = 0.4
    """Width of the thinnest ridge or groove that is printed at all."""
    smallest_wall_mm: float = 0.9
    """Width of the thinnest wall that stands by itself: two beads."""
    bed_mm: tuple[float, float, float] = (250.0, 210.0, 210.0)
    """Width, depth and height of what fits the machine."""

    def __post_init__(self) -> None:
        for name in ("layer_mm", "line_width_mm", "smallest_feature_mm", "smallest_wall_mm"):
            if not 0 < getattr(self, name) < inf:
                raise ConfigError(
                    f"{name.replace('_', '-')} of a printer must be positive, not {getattr(self, name):g}."
                )
        if not 0 <= self.bulge <= 1:
            raise ConfigError(f"the bulge of a bead must be 0 to 1 layer heights, not {self.bulge:g}.")
        if self.process == "fdm" and self.layer_mm >= self.line_width_mm:
            raise ConfigError(f"layers of {self.layer_mm:g} mm need a line wider than {self.line_width_mm:g} mm.")

    @property
    def layered(self) -> bool:
        """Whether layers change what the part looks like."""
        return self.process == "fdm"

    @property
    def visible_bulge(self) -> float | None:
        """The bulge of beads where layers change what the part looks like, None where they do not."""
        return self.bulge if self.layered else None

    def fits(self, size_mm: tuple[float, float, float]) -> bool:
        """Whether a part of this width, depth and height fits the machine, turned about the vertical if need be."""
        width, depth = sorted(size_mm[:2])
        bed_width, bed_depth = sorted(self.bed_mm[:2])
        return width <= bed_width and depth <= bed_depth and size_mm[2] <= self.bed_mm[2]


_FDM = Printer("fdm")
PRINTERS: dict[str, Printer] = {
    "smooth": Printer("smooth", 0.05, 0.1, 0.0, 0.1, 0.4, (inf, inf, inf)),
    "fdm-0.2": _FDM,
    "fdm-0.12": replace(_FDM, layer_mm=0.12),
    "fdm-0.08": replace(_FDM, layer_mm=0.08),
    "resin": Printer("resin", 0.05, 0.1, 0.0, 0.1, 0.4, (143.0, 89.0, 175.0)),
}
"""Filament with a 0.4 mm nozzle at three layer heights, a desktop resin printer, and anything without layers."""

"""What a printer extrudes: the paths of the beads, layer by layer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

Role = Literal["outer", "inner", "fill", "support"]
"""Of a bead: along the outline of its layer, along that, in the area within (walls' gaps, tops, bridges), or beside the
part (supports, brim, skirt)."""


@dataclass(frozen=True)
class Bead:
    """One extruded line.

    points ``[P,2]``: mm, the middle of the bead. width ``[P]``: mm. top: mm above the bed. height: mm.
    closed: the last point is joined to the first, which is not repeated.
    """

    points: np.ndarray
    width: np.ndarray
    top: float
    height: float
    role: Role
    closed: bool

    @property
    def bottom(self) -> float:
        """Height of the lower side above the bed."""
        return self.top - self.height

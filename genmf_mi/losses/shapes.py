"""Shapes that most losses share; B images of H × W pixels. The tests check them at run time."""

from __future__ import annotations

from typing import TypeAlias

from jaxtyping import Float
from torch import Tensor

GreyImages: TypeAlias = Float[Tensor, "B 1 H W"]
"""Grey values, depth or masks."""
NormalImages: TypeAlias = Float[Tensor, "B 3 H W"]
Field: TypeAlias = Float[Tensor, "1 X Y Z"]
"""Stress or Φ on the grid [-1, 1]³."""
Scalar: TypeAlias = Float[Tensor, ""]

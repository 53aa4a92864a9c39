"""A loss term of one's own: keep the foot of the part flat, for example to leave room for a label.

    python examples/custom_loss.py [watermelon]

The argument ``extra_terms`` of :func:`genmf_mi.refine` is called in every iteration with what the camera sees of the
part, what it sees of the textured object, and the geometry. It returns weighted scalars by name, which are added to the
loss and recorded in the history under these names. On the watermelon with the preset ``draft``, the mean relief in the
foot falls from 0.12 mm without the term to 0.06 mm, and from 0.19 to 0.15 mm above it.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from torch import Tensor

import genmf_mi
from genmf_mi.core.config import PRESETS
from genmf_mi.geometry.parameterization import Geometry
from genmf_mi.render.bridge import Buffers

FOOT = 0.25
"""Share of the object's height, in the picture and on the print bed, that counts as its foot."""


class FlatFoot:
    """λ times the mean distance between the part and its initial surface along the rays, over the foot in the picture.

    The reference shows the textured object, whose surface is the initial one, so that its depth is the target.
    """

    def __init__(self, weight: float) -> None:
        self.weight = weight

    def __call__(self, image: Buffers, reference: Buffers, geometry: Geometry) -> dict[str, Tensor]:
        """Images are ``[1,channels,H,W]``, row 0 at the top; depths are in normalised units (longest side 1.9)."""
        assert image.depth is not None and image.coverage is not None
        assert reference.depth is not None and reference.coverage is not None
        if reference.coverage[:, :, [0, -1]].any() or reference.coverage[..., [0, -1]].any():
            return {"flat_foot": 0.0 * image.depth.sum()}  # a close view, which cuts off the foot or more
        rows = reference.coverage.amax(dim=(0, 1, 3)).nonzero()
        top, bottom = int(rows[0]), int(rows[-1])
        whole = (image.coverage.detach() > 0.999) & (reference.coverage > 0.999)  # no outlines
        whole[:, :, : bottom - round(FOOT * (bottom - top))] = False
        distance = (image.depth - reference.depth).abs()[whole]
        return {"flat_foot": self.weight * distance.sum() / max(len(distance), 1)}


def main(
    asset: str = "watermelon",
    *,
    weight: float = 100.0,
    config: genmf_mi.RefineConfig | None = None,
    scene: str | Path | None = None,
) -> tuple[float, float]:
    """Refine ``asset`` with the term; returns the mean relief in the foot and above it, in mm."""
    result = genmf_mi.refine(asset, config or PRESETS["draft"], scene=scene, extra_terms=FlatFoot(weight))
    height = result.vertices_mm[:, 2] / result.vertices_mm[:, 2].max()
    foot, above = (float(np.abs(result.relief_mm[chosen]).mean()) for chosen in (height < FOOT, height >= FOOT))
    print(f"mean relief: {foot:.3f} mm in the foot, {above:.3f} mm above it")
    last = [record for record in result.history if record["flat_foot"] > 0 or weight == 0][-1]
    print(f"the term is {last['flat_foot']:.4f} of a loss of {last['loss']:.4f} in the end")
    return foot, above


if __name__ == "__main__":
    main(*sys.argv[1:2])

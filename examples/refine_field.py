"""Refine a signed distance Φ, as image-to-3D generators have it before they make a mesh.

    python examples/refine_field.py [InstantMesh.npz]

Without a file, Φ is that of two overlapping balls with painted stripes; the topology may change while Φ is refined.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

import genmf_mi
from genmf_mi.assets.generators import files
from genmf_mi.core.config import PRESETS


def main(
    path: str | None = None,
    out: str | Path | None = "runs/refine_field",
    *,
    samples: int = 129,
    config: genmf_mi.RefineConfig | None = None,
    scene: str | Path | None = None,
) -> genmf_mi.Result:
    """Refine the field in a file, or the two balls, and print what became of it.

    Args:
        path: a file with the arrays of InstantMesh or TRELLIS, see docs/generators.md; the two balls if None.
        out: folder for all files; None writes nothing.
        samples: per axis of the grid of the two balls.
        config: all settings; the preset ``draft`` if None.
        scene: a scene file of one's own, with other views or lights.
    """
    shape = files.load(path) if path else two_balls(samples)
    result = genmf_mi.refine(shape, config or PRESETS["draft"], out=out, scene=scene, force=True)
    before, after = result.metrics["before"], result.metrics["after"]
    print(f"LPIPS {before['lpips_alex']:.3f} -> {after['lpips_alex']:.3f}")
    print(f"closed: {result.metrics['solid']['watertight']}, bodies: {result.metrics['solid']['bodies']}")
    return result


def two_balls(samples: int) -> genmf_mi.SdfAsset:
    """Φ ``[m,m,m]``, indexed x, y, z with y up, negative inside; and the colours of a mesh in the same frame."""
    ticks = np.linspace(-1, 1, samples, dtype=np.float32)
    points = np.stack(np.meshgrid(ticks, ticks, ticks, indexing="ij"), axis=-1)
    lower = np.linalg.norm(points - [0, -0.3, 0], axis=-1) - 0.55
    upper = np.linalg.norm(points - [0, 0.4, 0], axis=-1) - 0.4
    shape = genmf_mi.SdfAsset("two_balls", np.minimum(lower, upper).astype(np.float32))

    vertices, faces = shape.surface()
    dark = np.sin(14 * vertices[:, 1]) > 0.3
    colours = np.where(dark[:, None], [0.05, 0.05, 0.2], [0.8, 0.7, 0.4])  # linear RGB
    painted = genmf_mi.Asset.from_arrays("two_balls", vertices, faces, colours=colours)
    return replace(shape, coloured=painted)


if __name__ == "__main__":
    main(*sys.argv[1:2])

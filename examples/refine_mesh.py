"""Refine a textured mesh, and see what came out.

    python examples/refine_mesh.py [strawberry | bus.glb] [OUT]

The asset is a bundled sample or a file. On two CPU cores this takes about one minute with the preset ``draft``.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import genmf_mi
from genmf_mi.core.config import PRESETS
from genmf_mi.core.progress import Progress


class PrintedProgress(Progress):
    """Prints the stages, and the loss of every tenth iteration."""

    def stage(self, name: str) -> None:
        print(f"{name} ...")

    def advance(self, done: float, total: float, values: Mapping[str, float] | None = None) -> None:
        if values and done % 10 == 0:
            print(f"  iteration {done:.0f} of {total:.0f}: loss {values['loss']:.4f}")

    def warn(self, message: str) -> None:
        print(f"warning: {message}")


def main(
    asset: str = "strawberry",
    out: str | Path = "runs/refine_mesh",
    *,
    config: genmf_mi.RefineConfig | None = None,
    scene: str | Path | None = None,
) -> genmf_mi.Result:
    """Refine ``asset`` into the folder ``out`` and print how much closer it comes to the textured object.

    Args:
        config: all settings; a part of 80 mm in the preset ``draft`` if None.
        scene: a scene file of one's own, with other views or lights.
    """
    config = config or replace(PRESETS["draft"], size_mm=80.0)
    result = genmf_mi.refine(asset, config, out=out, scene=scene, force=True, progress=PrintedProgress())

    print(f"{len(result.faces)} faces, relief up to {result.metrics['relief_mm']['max']:.2f} mm")
    for name in ("before", "displacement", "after"):
        scores = result.metrics[name]
        print(f"{name:>12}: LPIPS {scores['lpips_alex']:.3f}, SSIM {scores['ssim']:.3f}")
    print(f"print {out}/refined.3mf, look at {out}/before_after.png and {out}/report.html")
    return result


if __name__ == "__main__":
    main(*sys.argv[1:3])

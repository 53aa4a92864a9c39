"""Relief on a flat cap, 95 mm wide and 15 mm high, that is all base: where the base carries most of the stress.

Bumps of 1 mm and a wavelength of 4 mm fade out over 4 mm above the base. Beside :mod:`benchmarks.verification.relief`,
where the base is far from the relief, this shows how far a broad base dilutes the effect of relief on the means.
"""

from __future__ import annotations

import json

import numpy as np

from benchmarks import record
from benchmarks.inputs import Inputs
from genmf_mi.stress.data.recipe import contour
from genmf_mi.stress.fem import simulation as fem
from genmf_mi.stress.fem.statistics import summary

HEIGHT_MM, RADIUS_MM = 15.0, 47.5
"""Of the cap and of its base."""
WAVELENGTH_MM, EDGE_MM, GRID = 4.0, 1.2, 129


def main(inputs: Inputs) -> None:
    """Simulate the smooth cap and the one with relief.

    Args:
        inputs: What all benchmarks have in common; this one reads none of them.
    """
    rows = []
    for amplitude in (0.0, 1.0):
        vertices, faces = contour(distance(amplitude))
        numbers = summary(fem.simulate(vertices, faces, fem.Settings(size_mm=2 * RADIUS_MM, edge_mm=EDGE_MM)))
        rows.append(
            {
                "amplitude_mm": amplitude,
                "nodes": numbers["mesh"]["nodes"],
                **{key: round(value, 4) for key, value in numbers["von_mises_mpa"].items()},
                "surface_band": round(numbers["surface_band"]["mean"], 4),
            }
        )
        print(json.dumps(rows[-1]), flush=True)
    ratio = {key: rows[1][key] / rows[0][key] for key in ("mean", "p99_9", "surface_band")}
    shape = f"cap {2 * RADIUS_MM:.0f} mm wide, {HEIGHT_MM:.0f} mm high"
    record.write_verification("relief_flat_cap", {"shape": shape, "rows": rows, "ratio": ratio})


def distance(amplitude_mm: float) -> np.ndarray:
    """Φ ``[129,129,129]`` about the surface, in units of half the grid of 100 mm, y up."""
    mm = np.linspace(-50.0, 50.0, GRID)
    x, y, z = np.meshgrid(mm, mm, mm, indexing="ij")
    height = y + HEIGHT_MM / 2
    radius = (RADIUS_MM**2 + HEIGHT_MM**2) / (2 * HEIGHT_MM)
    ball = np.sqrt(x**2 + (height - HEIGHT_MM + radius) ** 2 + z**2) - radius
    k = 2 * np.pi / WAVELENGTH_MM
    bumps = amplitude_mm * np.sin(k * x) * np.sin(k * z) * np.clip((height - 2.0) / 4.0, 0.0, 1.0)
    return np.maximum(ball - bumps, -height) / 50.0

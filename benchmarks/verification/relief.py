"""Is relief seen? The cap of a ball with and without bumps of 1 mm and a wavelength of 4 mm, a = 1.2 mm, Φ on 129³."""

from __future__ import annotations

import json

import numpy as np

from genmf_mi.stress import fem
from genmf_mi.stress.recipe import contour
from genmf_mi.stress.statistics import summary

HEIGHT_MM, BASE_MM = 15.0, 47.5


def cap(amplitude_mm: float, wavelength_mm: float = 4.0, n: int = 129) -> tuple[np.ndarray, np.ndarray]:
    """Surface of a cap, base down; the bumps fade out over the last 4 mm above the base."""
    mm = np.linspace(-50.0, 50.0, n)
    x, y, z = np.meshgrid(mm, mm, mm, indexing="ij")
    radius = (BASE_MM**2 + HEIGHT_MM**2) / (2 * HEIGHT_MM)
    y = y + HEIGHT_MM / 2
    ball = np.sqrt(x**2 + (y - HEIGHT_MM + radius) ** 2 + z**2) - radius
    k = 2 * np.pi / wavelength_mm
    bumps = amplitude_mm * np.sin(k * x) * np.sin(k * z) * np.clip((y - 2.0) / 4.0, 0.0, 1.0)
    return contour(np.maximum(ball - bumps, -y) / 50.0)


def main() -> dict:
    rows = []
    for amplitude in (0.0, 1.0):
        vertices, faces = cap(amplitude)
        numbers = summary(fem.simulate(vertices, faces, fem.Settings(size_mm=2 * BASE_MM, edge_mm=1.2)))
        rows.append(
            {
                "amplitude_mm": amplitude,
                "nodes": numbers["mesh"]["nodes"],
                **{k: round(v, 4) for k, v in numbers["von_mises_mpa"].items()},
                "surface_band": round(numbers["surface_band"]["mean"], 4),
            }
        )
        print(json.dumps(rows[-1]), flush=True)
    ratio = {k: rows[1][k] / rows[0][k] for k in ("mean", "p99_9", "surface_band")}
    print(ratio)
    return {"rows": rows, "ratio": ratio, "limit": {"surface_band": 1.08}}


if __name__ == "__main__":
    main()

"""Does the stress show relief? Half a ball of 100 mm standing on its flat side, with and without relief on its cap.

The relief has a wavelength of 4 mm along the surface and covers what is within 60° of the pole; it is judged within
45°, away from its own rim and from the base. "Amplitude 1 mm" is from the mean surface to the crest, so 2 mm from the
bottom of a groove to a crest. Three patterns: bumps sin·sin as in an egg carton, rings sin, and a sum of twelve waves
in random directions of the same root mean square as the bumps.

Three means of von Mises are compared with those of the smooth ball:

- surface_band: of the whole part, as in stress.json, base included;
- cap_band: of the cap, less than 4 mm below the surface of the part itself, grooves included;
- cap_layer: of the cap, less than 4 mm below the surface of the smooth ball, as in ``stress compare``.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, replace

import numpy as np

from benchmarks import record
from benchmarks.inputs import Inputs
from genmf_mi.core.frame import HALF_EXTENT, Frame
from genmf_mi.sdf.distance import axis, sample, signed_distance
from genmf_mi.stress.fem import simulation as fem
from genmf_mi.stress.fem.statistics import SURFACE_BAND_MM, summary, weighted_percentiles
from genmf_mi.stress.report.comparison import in_layer

RADIUS_MM = 50.0
COVERED_DEGREES, JUDGED_DEGREES = 60.0, 45.0
REQUIRED = 1.08


@dataclass(frozen=True)
class Case:
    """pattern: bumps, rings or random. base_mm: height of the flat side over the centre of the ball."""

    pattern: str = "bumps"
    amplitude_mm: float = 1.0
    wavelength_mm: float = 4.0
    edge_mm: float = 1.2
    grid: int = 129
    base_mm: float = 0.0


CASES = (
    Case(),
    Case("rings"),
    Case("random"),
    Case(amplitude_mm=0.5),
    Case("rings", 0.5),
    Case(wavelength_mm=8.0),
    Case(edge_mm=1.6),
    Case(grid=257),
    Case(grid=257, edge_mm=1.0),
    Case(base_mm=-45.0, edge_mm=1.6),
)


def height(case: Case, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """The pattern, of unit amplitude, at places ``u``, ``v`` in mm along the surface from the pole."""
    k = 2 * np.pi / case.wavelength_mm
    if case.pattern == "bumps":
        return np.sin(k * u) * np.sin(k * v)
    if case.pattern == "rings":
        return np.sin(k * np.hypot(u, v))
    rng = np.random.default_rng(0)
    waves = np.zeros_like(u)
    for direction, phase in zip(rng.uniform(0, 2 * np.pi, 12), rng.uniform(0, 2 * np.pi, 12), strict=True):
        waves += np.cos(k * (u * np.cos(direction) + v * np.sin(direction)) + phase)
    return 0.5 * waves / waves.std()


def simulate(case: Case) -> fem.Simulation:
    """Φ is the exact distance to a triangulation of edges of 0.4 mm, cut off flat at the base."""
    import trimesh

    sphere = trimesh.creation.icosphere(subdivisions=8)
    x, y, z = sphere.vertices.T
    polar, azimuth = np.arccos(np.clip(y, -1, 1)), np.arctan2(z, x)
    u, v = RADIUS_MM * polar * np.cos(azimuth), RADIUS_MM * polar * np.sin(azimuth)
    fade = np.clip(RADIUS_MM * (np.radians(COVERED_DEGREES) - polar) / case.wavelength_mm, 0, 1)
    radius = 1 + case.amplitude_mm / RADIUS_MM * fade * height(case, u, v)
    phi = signed_distance(HALF_EXTENT * sphere.vertices * radius[:, None], sphere.faces, case.grid)
    base = HALF_EXTENT * case.base_mm / RADIUS_MM
    phi = np.maximum(phi, (base - axis(case.grid))[None, :, None]).astype(np.float32)
    frame = Frame((0.0, 0.0, 0.0), HALF_EXTENT / RADIUS_MM, 2 * RADIUS_MM)
    return fem.simulate_distance(phi, frame, fem.Settings(edge_mm=case.edge_mm, grid=case.grid))


def measure(part: fem.Simulation, smooth: fem.Simulation) -> dict:
    """The means above and percentiles of one part, MPa, and its relief in mm."""
    mm = part.frame.mm_per_unit
    centroids = part.mesh.points[part.mesh.cells].mean(axis=1)
    cap = centroids[:, 1] > np.cos(np.radians(JUDGED_DEGREES)) * np.linalg.norm(centroids, axis=1)
    band = cap & (sample(part.phi, centroids) * mm >= -SURFACE_BAND_MM)
    layer = cap & in_layer(part, smooth)
    value, volume = part.field.von_mises, part.field.elements.volumes
    surface = part.mesh.points[np.unique(part.mesh.boundary())] * mm
    radius = np.linalg.norm(surface, axis=1)
    off = radius[surface[:, 1] > np.cos(np.radians(JUDGED_DEGREES)) * radius] - RADIUS_MM
    numbers = summary(part)
    figures = {
        "mean": numbers["von_mises_mpa"]["mean"],
        "p99_9": numbers["von_mises_mpa"]["p99_9"],
        "surface_band": numbers["surface_band"]["mean"],
        "cap_band": np.average(value[band], weights=volume[band]),
        "cap_layer": np.average(value[layer], weights=volume[layer]),
        "cap_layer_p99": weighted_percentiles(value[layer], volume[layer], (99.0,))[0],
        "cap_layer_max": value[layer].max(),
        "relief_low_mm": off.min(),
        "relief_high_mm": off.max(),
        "relief_rms_mm": off.std(),
    }
    return {"nodes": len(part.mesh.points), **{name: round(float(x), 4) for name, x in figures.items()}}


def main(inputs: Inputs) -> None:
    """Simulate every case and its smooth counterpart.

    Args:
        inputs: What all benchmarks have in common; this one reads none of them.
    """
    smooth: dict[Case, fem.Simulation] = {}
    rows = []
    for case in CASES:
        plain = replace(case, pattern="bumps", amplitude_mm=0.0, wavelength_mm=4.0)
        if plain not in smooth:
            smooth = {plain: simulate(plain)}
        before, after = measure(smooth[plain], smooth[plain]), measure(simulate(case), smooth[plain])
        over = {k: round(after[k] / before[k], 4) for k in ("mean", "surface_band", "cap_band", "cap_layer")}
        rows.append({**vars(case), "smooth": before, "relief": after, "relief_over_smooth": over})
        print(json.dumps(rows[-1]), flush=True)
    record.write_verification("relief", {"required": {"cap_layer": REQUIRED}, "rows": rows})

"""The figures that summarise a stress field."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np

from genmf_mi.core.frame import HALF_EXTENT
from genmf_mi.core.progress import Progress
from genmf_mi.sdf.distance import sample
from genmf_mi.stress.fem.simulation import Simulation
from genmf_mi.stress.fem.warpage import warpage

SURFACE_BAND_MM = 4.0
"""Depth of the surface band. Relief changes the field within about one wavelength of the surface; the mean over the
whole body hardly changes."""


def surface_band_depth(size_mm: float) -> float:
    """Depth of the surface band in normalised units, for a part of that longest side: 0.076 at 100 mm."""
    return SURFACE_BAND_MM * 2 * HALF_EXTENT / size_mm


def weighted_percentiles(value: np.ndarray, weight: np.ndarray, percents: tuple[float, ...]) -> list[float]:
    """The smallest value below or at which each of ``percents`` of the weight lies."""
    order = np.argsort(value)
    share = np.cumsum(weight[order]) / weight.sum()
    return [float(value[order][min(np.searchsorted(share, p / 100), len(value) - 1)]) for p in percents]


def summary(simulation: Simulation) -> dict:
    """What ``stress.json`` holds. Stresses in MPa, weighted by volume; lengths in mm, temperatures in °C, wall time
    in seconds."""
    field, settings = simulation.field, simulation.settings
    volumes = field.elements.volumes
    p50, p95, p99, p999 = weighted_percentiles(field.von_mises, volumes, (50.0, 95.0, 99.0, 99.9))
    centroids = simulation.mesh.points[simulation.mesh.cells].mean(axis=1)
    depth = -sample(simulation.phi, centroids) * simulation.frame.mm_per_unit
    band = depth <= SURFACE_BAND_MM
    quality = field.mesh.quality
    total = float(volumes.sum())
    return {
        "von_mises_mpa": {
            "mean": float(np.average(field.von_mises, weights=volumes)),
            "p50": p50,
            "p95": p95,
            "p99": p99,
            "p99_9": p999,
            "max": float(field.von_mises.max()),
        },
        "surface_band": {
            "depth_mm": SURFACE_BAND_MM,
            "mean": float(np.average(field.von_mises[band], weights=volumes[band])),
            "p99_9": weighted_percentiles(field.von_mises[band], volumes[band], (99.9,))[0],
            "volume_fraction": float(volumes[band].sum() / total),
        },
        "displacement_max_mm": float(np.linalg.norm(field.displacement, axis=1).max()),
        "temperature_celsius": [float(field.temperature.min()), float(field.temperature.max())],
        "mesh": {
            "nodes": len(field.mesh.points),
            "tetrahedra": len(field.mesh.cells),
            "volume_mm3": total,
            "quality_min": float(quality.min()),
            "quality_mean": float(quality.mean()),
            "dropped_bodies": len(simulation.dropped),
            "dropped_fraction": float(sum(simulation.dropped) / (total + sum(simulation.dropped))),
            "thin_fraction": simulation.thin_fraction,
        },
        "iterations": field.iterations,
        "seconds": {name: round(seconds, 3) for name, seconds in simulation.seconds.items()},
        "settings": {
            "size_mm": settings.size_mm,
            "edge_mm": settings.edge_mm,
            "grid": settings.grid,
            "material": settings.material,
            **vars(settings.protocol),
        },
    }


def summary_with_warpage(simulation: Simulation, progress: Progress | None = None) -> dict:
    """:func:`summary`, and under ``warpage`` the :class:`genmf_mi.stress.fem.warpage.Warpage` of the part, None for one
    that is too thin for its mesh. Raises :class:`genmf_mi.stress.fem.linear.SolveError`."""
    progress = progress or Progress()
    progress.stage("warpage")
    bent = warpage(simulation.phi, simulation.frame, simulation.settings, progress)
    return {**summary(simulation), "warpage": bent and asdict(bent)}

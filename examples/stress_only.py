"""The thermal stress of a solid, without rendering: by finite elements, and by the network in a fraction of the time.

    python examples/stress_only.py [part.stl]

Without a file it takes an angle bracket. Neither Mitsuba nor a texture is needed.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import trimesh

from genmf_mi.stress.fem import simulation, statistics, surface
from genmf_mi.stress.model import predictor


def main(
    path: str | Path | None = None, *, size_mm: float = 100.0, edge_mm: float = 1.6
) -> dict[str, dict[str, float]]:
    """Simulate and predict the stress of the solid in a file.

    Args:
        path: a mesh in any format that :func:`genmf_mi.load` reads; the bracket if None.
        size_mm: longest side of the printed part.
        edge_mm: edge length of the tetrahedra.

    Returns:
        Mean, 99.9th percentile and maximum of von Mises in MPa, ``simulated`` and ``predicted``.
    """
    vertices, faces = surface.load(path) if path else bracket()

    settings = simulation.Settings(size_mm=size_mm, edge_mm=edge_mm, material="pla")
    simulated = simulation.simulate(vertices, faces, settings)
    warmest = simulated.field.temperature.max()
    print(f"{len(simulated.field.mesh.points)} nodes; the inside is still at {warmest:.1f} °C")

    network = predictor.Predictor(settings=settings)
    predicted = network.predict(vertices, faces)
    for sentence in predicted.warnings:
        print(f"do not trust the prediction: {sentence}")

    stress = {
        "simulated": statistics.summary(simulated)["von_mises_mpa"],
        "predicted": predictor.summary(predicted)["von_mises_mpa"],
    }
    for name, values in stress.items():
        print(f"{name}: mean {values['mean']:.3f} MPa, 99.9 % of the volume below {values['p99_9']:.2f} MPa")
    return {name: {key: values[key] for key in ("mean", "p99_9", "max")} for name, values in stress.items()}


def bracket() -> tuple[np.ndarray, np.ndarray]:
    """An angle bracket of 3 × 3 × 2, y up: two plates of thickness 0.6."""
    base = trimesh.creation.box(bounds=[(0, 0, 0), (3, 0.6, 2)])
    upright = trimesh.creation.box(bounds=[(0, 0, 0), (0.6, 3, 2)])
    solid = trimesh.boolean.union([base, upright], engine="manifold")
    return np.asarray(solid.vertices), np.asarray(solid.faces)


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else None)

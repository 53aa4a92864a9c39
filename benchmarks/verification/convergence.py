"""Mean and p99.9 of some shapes as the tetrahedra shrink; the soft clamp keeps the maximum bounded.

Besides, each of the coarser meshes is solved with quadratic elements: what is left of the difference then comes from
the facets that stand for the surface, the rest from linear elements.
"""

from __future__ import annotations

import json

import numpy as np

from benchmarks import record
from benchmarks.inputs import Inputs
from genmf_mi.stress.fem import reference, surface
from genmf_mi.stress.fem import simulation as fem
from genmf_mi.stress.fem.materials import material
from genmf_mi.stress.fem.statistics import summary

SHAPES = ("bunny", "spotcow", "maxplanck", "koala", "rockerarm", "handclosed", "wingnut")
EDGES_MM = (4.0, 2.5, 1.6, 1.2)
QUADRATIC_UP_TO = 12_000
"""Nodes of the largest mesh that is also solved with quadratic elements, some eight times as many unknowns."""


def main(inputs: Inputs) -> None:
    """Simulate each shape with each edge length.

    Args:
        inputs: What all benchmarks have in common; this one reads --meshes.
    """
    rows = []
    for path in inputs.mesh_files(SHAPES):
        vertices, faces = surface.load(path)
        for edge in EDGES_MM:
            figures = row(vertices, faces, fem.Settings(edge_mm=edge))
            rows.append({"shape": path.stem, "edge_mm": edge, **figures})
            print(json.dumps(rows[-1]), flush=True)
        finest = rows[-1]
        for one in rows[-len(EDGES_MM) :]:
            one["mean_over_finest"] = round(one["mean"] / finest["mean"], 4)
            one["p99_9_over_finest"] = round(one["p99_9"] / finest["p99_9"], 4)
    record.write_verification("convergence", {"rows": rows})


def row(vertices: np.ndarray, faces: np.ndarray, settings: fem.Settings) -> dict:
    """The figures of one shape on one mesh; MPa, mm³ and seconds."""
    simulation = fem.simulate(vertices, faces, settings)
    numbers = summary(simulation)
    figures = {
        "nodes": numbers["mesh"]["nodes"],
        "volume_mm3": round(numbers["mesh"]["volume_mm3"], 1),
        **{k: round(v, 4) for k, v in numbers["von_mises_mpa"].items()},
        "surface_band": round(numbers["surface_band"]["mean"], 4),
        "seconds_cpu": round(sum(numbers["seconds"].values()), 1),
    }
    if figures["nodes"] <= QUADRATIC_UP_TO:
        quadratic = reference.solve(
            simulation.field.mesh, material(settings.material), settings.protocol, order=2, tolerance=1e-6
        )
        figures["mean_quadratic"] = round(quadratic.mean, 4)
    return figures

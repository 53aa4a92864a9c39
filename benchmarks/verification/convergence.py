"""Mean and p99.9 of some shapes as the tetrahedra shrink; the soft clamp keeps the maximum bounded.

python -m benchmarks.verification.convergence MESH ...

Besides, each of the coarser meshes is solved with quadratic elements: what is left of the difference then comes from
the facets that stand for the surface, the rest from linear elements.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from benchmarks import verification
from genmf_mi.stress.fem import reference, surface
from genmf_mi.stress.fem import simulation as fem
from genmf_mi.stress.fem.materials import material
from genmf_mi.stress.fem.statistics import summary

EDGES_MM = (4.0, 2.5, 1.6, 1.2)
QUADRATIC_UP_TO = 12_000
"""Nodes of the largest mesh that is also solved with quadratic elements, some eight times as many unknowns."""


def main(shapes: dict[str, Path]) -> dict:
    rows = []
    for name, path in shapes.items():
        vertices, faces = surface.load(path)
        for edge in EDGES_MM:
            rows.append({"shape": name, "edge_mm": edge, **row(vertices, faces, fem.Settings(edge_mm=edge))})
            print(json.dumps(rows[-1]), flush=True)
        finest = rows[-1]
        for one in rows[-len(EDGES_MM) :]:
            one["mean_over_finest"] = round(one["mean"] / finest["mean"], 4)
            one["p99_9_over_finest"] = round(one["p99_9"] / finest["p99_9"], 4)
    return {"rows": rows}


def row(vertices, faces, settings: fem.Settings) -> dict:
    simulation = fem.simulate(vertices, faces, settings)
    numbers = summary(simulation)
    found = {
        "nodes": numbers["mesh"]["nodes"],
        "volume_mm3": round(numbers["mesh"]["volume_mm3"], 1),
        **{k: round(v, 4) for k, v in numbers["von_mises_mpa"].items()},
        "surface_band": round(numbers["surface_band"]["mean"], 4),
        "seconds_cpu": round(sum(numbers["seconds"].values()), 1),
    }
    if found["nodes"] <= QUADRATIC_UP_TO:
        quadratic = reference.solve(
            simulation.field.mesh, material(settings.material), settings.protocol, order=2, tolerance=1e-6
        )
        found["mean_quadratic"] = round(quadratic.mean, 4)
    return found


if __name__ == "__main__":
    verification.record("convergence", main({Path(p).stem: Path(p) for p in sys.argv[1:]}))

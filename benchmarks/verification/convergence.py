"""Mean and p99.9 of three shapes as the tetrahedra shrink; the soft clamp keeps the maximum bounded."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from genmf_mi.stress import fem, surface
from genmf_mi.stress.statistics import summary

EDGES_MM = (4.0, 2.5, 1.6, 1.2)


def main(shapes: dict[str, Path]) -> dict:
    rows = []
    for name, path in shapes.items():
        vertices, faces = surface.load(path)
        for edge in EDGES_MM:
            numbers = summary(fem.simulate(vertices, faces, fem.Settings(edge_mm=edge)))
            rows.append(
                {
                    "shape": name,
                    "edge_mm": edge,
                    "nodes": numbers["mesh"]["nodes"],
                    **{k: round(v, 4) for k, v in numbers["von_mises_mpa"].items()},
                    "surface_band": round(numbers["surface_band"]["mean"], 4),
                    "seconds": round(sum(numbers["seconds"].values()), 1),
                }
            )
            print(json.dumps(rows[-1]), flush=True)
    return {"rows": rows}


if __name__ == "__main__":
    main({Path(p).stem: Path(p) for p in sys.argv[1:]})

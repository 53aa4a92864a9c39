"""Is the network's gradient worth following? One step along it, judged by finite elements.

    python -m benchmarks.stress_gradient DIR [--weights FILE] [--count 10]

Shapes of the test split that have relief, until there are enough: their surface moves along -∂L/∂vertices, smoothed as
in a refinement, L being the mean stress of the surface band. The solver tells that mean before and after.
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import torch
import tyro
from skimage.measure import marching_cubes
from tyro.conf import Positional

from benchmarks import record
from genmf_mi.core.frame import Frame
from genmf_mi.geometry.displacement_bounds import STANDING
from genmf_mi.geometry.mesh import ImplicitDiffusion, percentile
from genmf_mi.geometry.mesh_distance import MeshDistance
from genmf_mi.losses import stress as losses
from genmf_mi.stress.data.reader import StressSamples
from genmf_mi.stress.fem import simulation as fem
from genmf_mi.stress.fem.statistics import summary
from genmf_mi.stress.model.network import crop_box
from genmf_mi.stress.model.predictor import Predictor
from genmf_mi.stress.training.metrics import surface_band_depth

SMOOTHING = 30.0
"""λ of the preconditioner, as in a refinement."""


def main(
    data: Positional[Path],
    /,
    weights: Path | None = None,
    split: str = "test",
    count: int = 10,
    step_mm: float = 0.3,
    edge_mm: float = 1.2,
    threads: int = 1,
) -> None:
    """Step, simulate, compare.

    Args:
        data: Folder of samples.
        weights: Of the network; those of the package if not given.
        split: Of which shapes.
        count: How many of them.
        step_mm: How far 99 % of the vertices move at most.
        edge_mm: Side of the lattice that the tetrahedra come from.
        threads: Of the CPU.
    """
    torch.set_num_threads(threads)
    predictor, samples = Predictor(weights), StressSamples(data, split)
    rows = []
    for item, about in enumerate(samples.records):
        if about["relief_mm"] is None or len(rows) == count:
            continue
        started = time.perf_counter()
        rows.append({"shape": about["shape"], **step(samples[item][0], predictor, step_mm, edge_mm)})
        print(rows[-1], f"{time.perf_counter() - started:.0f} s", flush=True)
    lowered = sum(row["found"] < 1 for row in rows)
    print(f"lower in {lowered} of {len(rows)}")
    record.write("stress_gradient", {"step_mm": step_mm, "edge_mm": edge_mm, "lowered": lowered, "shapes": rows})


def step(phi: torch.Tensor, predictor: Predictor, step_mm: float, edge_mm: float) -> dict:
    """``predicted`` and ``found``: the mean of the surface band after a step over that before; ``moved_mm``: the mean
    way of the vertices. ``phi [1,n,n,n]``."""
    n = phi.shape[-1]
    vertices, faces, _, _ = marching_cubes(phi[0].numpy(), 0.0)
    vertices = torch.as_tensor(vertices * (2.0 / (n - 1)) - 1.0, dtype=torch.float32).requires_grad_()
    faces = faces.astype(np.int64)
    mm = Frame.of(vertices.detach().numpy(), predictor.settings.size_mm).mm_per_unit
    depth = surface_band_depth(predictor.settings.size_mm)
    distance, box = MeshDistance(faces, n, every=1), crop_box(phi)

    def band(vertices: torch.Tensor) -> torch.Tensor:
        field = distance(vertices)
        return losses.mean(predictor.field(field, box), losses.band(field, depth))

    before = band(vertices)
    before.backward()
    smoother = ImplicitDiffusion(faces, len(vertices), SMOOTHING)
    with torch.no_grad():
        way = -smoother(smoother(vertices.grad))
        length = way.norm(dim=1)
        way *= step_mm / mm / percentile(length, 0.99)
        # What stands goes on standing, as in a refinement; to lift a foot would lower the stress too easily
        height = vertices[:, 1] - vertices[:, 1].min()
        reach = (STANDING * height).clamp(max=step_mm / mm)[:, None]
        way *= (reach / way.norm(dim=1, keepdim=True).clamp_min(1e-12)).clamp(max=1)
        moved = vertices + way
        predicted = float(band(moved) / before)
    found = [simulated(v.detach().numpy(), faces, predictor, edge_mm) for v in (vertices, moved)]
    return {
        "predicted": round(predicted, 4),
        "found": round(found[1] / found[0], 4),
        "band_mpa": round(found[0], 4),
        "moved_mm": round(float(way.norm(dim=1).mean()) * mm, 3),
    }


def simulated(vertices: np.ndarray, faces: np.ndarray, predictor: Predictor, edge_mm: float) -> float:
    """Mean of the surface band by finite elements, MPa."""
    settings = fem.Settings(predictor.settings.size_mm, edge_mm, predictor.settings.grid)
    return summary(fem.simulate(vertices, faces, settings))["surface_band"]["mean"]


if __name__ == "__main__":
    tyro.cli(main)

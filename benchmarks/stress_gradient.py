"""Is the network's gradient worth following? One step along it, verified by finite elements.

The surface of shapes with relief moves along -∂L/∂vertices, smoothed as in a refinement, L being the mean stress of the
surface band. The solver computes that mean before and after.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
import torch
from skimage.measure import marching_cubes

from benchmarks import record
from benchmarks.inputs import Inputs
from genmf_mi.core.frame import Frame
from genmf_mi.core.timer import Timer
from genmf_mi.geometry.displacement_bounds import BED_CONTACT_LIMIT
from genmf_mi.geometry.laplacian import ImplicitDiffusion
from genmf_mi.geometry.mesh_distance import MeshDistance
from genmf_mi.geometry.uniform_adam import percentile
from genmf_mi.losses import stress as losses
from genmf_mi.stress.data.reader import StressSamples
from genmf_mi.stress.fem import simulation as fem
from genmf_mi.stress.fem.statistics import summary, surface_band_depth
from genmf_mi.stress.model.network import crop_box
from genmf_mi.stress.model.predictor import Predictor

SMOOTHING = 30.0
"""λ of the preconditioner, as in a refinement."""


def main(
    inputs: Inputs,
    *,
    split: Literal["train", "validation", "test"] = "test",
    count: int = 10,
    step_mm: float = 0.3,
    edge_mm: float = 1.2,
    threads: int = 1,
) -> None:
    """Step, simulate, compare.

    Args:
        inputs: What all benchmarks have in common; this one reads --data and --weights.
        split: Of which shapes.
        count: How many of them, the first ones with relief.
        step_mm: How far 99 % of the vertices move at most.
        edge_mm: Side of the lattice that the tetrahedra come from.
        threads: Of the CPU.
    """
    torch.set_num_threads(threads)
    predictor, samples = Predictor(inputs.weights), StressSamples(inputs.require("data"), split)
    rows = []
    for item, about in enumerate(samples.records):
        if about["relief_mm"] is None or len(rows) == count:
            continue
        timer = Timer()
        rows.append({"shape": about["shape"], **step(samples[item][0], predictor, step_mm, edge_mm)})
        print(rows[-1], f"{timer.total:.0f} s", flush=True)
    lowered = sum(row["found"] < 1 for row in rows)
    print(f"lower in {lowered} of {len(rows)}")
    record.write("stress_gradient", {"step_mm": step_mm, "edge_mm": edge_mm, "lowered": lowered, "shapes": rows})


def step(phi: torch.Tensor, predictor: Predictor, step_mm: float, edge_mm: float) -> dict:
    """One step from the shape Φ < 0, ``phi [1,n,n,n]``.

    Returns ``predicted`` and ``found``, the mean of the surface band after the step over that before, by the network
    and by the solver; ``band_mpa``, that before; and ``moved_mm``, the mean displacement of the vertices.
    """
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
    smoother = ImplicitDiffusion.large_steps(faces, len(vertices), SMOOTHING)
    with torch.no_grad():
        assert vertices.grad is not None
        move = -smoother(smoother(vertices.grad))
        length = move.norm(dim=1)
        move *= step_mm / mm / percentile(length, 0.99)
        # The bed-contact limit of a refinement: to lift a foot would lower the stress too easily
        height = vertices[:, 1] - vertices[:, 1].min()
        reach = (BED_CONTACT_LIMIT * height).clamp(max=step_mm / mm)[:, None]
        move *= (reach / move.norm(dim=1, keepdim=True).clamp_min(1e-12)).clamp(max=1)
        moved = vertices + move
        predicted = float(band(moved) / before)
    means = [simulated(v.detach().numpy(), faces, predictor, edge_mm) for v in (vertices, moved)]
    return {
        "predicted": round(predicted, 4),
        "found": round(means[1] / means[0], 4),
        "band_mpa": round(means[0], 4),
        "moved_mm": round(float(move.norm(dim=1).mean()) * mm, 3),
    }


def simulated(vertices: np.ndarray, faces: np.ndarray, predictor: Predictor, edge_mm: float) -> float:
    """Mean of the surface band by finite elements, MPa."""
    settings = fem.Settings(predictor.settings.size_mm, edge_mm, predictor.settings.grid)
    return summary(fem.simulate(vertices, faces, settings))["surface_band"]["mean"]

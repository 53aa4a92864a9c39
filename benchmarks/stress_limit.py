"""How far can relief lower stress at all? Descent along the gradient of the stress alone, judged by finite elements.

    GENMF_TEST_ASSETS=DIR python -m benchmarks.stress_limit [NAMES ...] [--steps 16]

The surface of each asset moves within the bounds of a refinement, from where it is at first, with no thought of what
it looks like. What comes out is as low as a stress stage could bring it if appearance were free.
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import torch
import tyro
from tyro.conf import Positional

from benchmarks import record
from benchmarks.stress_stage import FIVE, MEASURES
from genmf_mi.assets import sources
from genmf_mi.core.config import RefineConfig
from genmf_mi.geometry.mesh import UniformAdam
from genmf_mi.pipeline import problem as prepare
from genmf_mi.render import scene, variant
from genmf_mi.stress.model.predictor import Predictor
from genmf_mi.stress.penalty import StressPenalty
from genmf_mi.stress.report import verification as verdict


def main(
    names: Positional[tuple[str, ...]] = FIVE,
    /,
    steps: int = 16,
    rate: float = 0.0,
    weights: Path | None = None,
    threads: int = 1,
) -> None:
    """Descend, simulate, tabulate.

    Args:
        names: Of assets in the folder ``GENMF_TEST_ASSETS``.
        steps: Of the optimiser, each with a look at the stress.
        rate: Learning rate; ten times that of a refinement, which makes more steps, if 0.
        weights: Of the network; those of the package if not given.
        threads: Of the CPU.
    """
    torch.set_num_threads(threads)
    folder, rows = Path(os.environ["GENMF_TEST_ASSETS"]), []
    for name in names:
        rows.append({"asset": name, **descend(folder / f"{name}.glb", steps, rate, weights)})
        print(rows[-1], flush=True)
    record.write("stress_limit", {"steps": steps, "assets": rows})


def descend(path: Path, steps: int, rate: float, weights: Path | None) -> dict:
    """``told`` and ``found``: the terms of the penalty and the solver's measures, over those before."""
    config = RefineConfig()
    rate = rate or 10 * config.learning_rate
    asset = sources.load(path)
    device = variant.use(config.device)
    with tempfile.TemporaryDirectory() as scratch:
        piece = prepare.prepare(asset, config, scene.find(asset.name), Path(scratch))
    relief, predictor = piece.movable(config, device), Predictor(weights)
    penalty = StressPenalty(predictor, relief.distance(predictor.settings.grid), relief.initial, every=1)
    adam = UniformAdam(relief.latent, rate, blocks=relief.blocks)
    for step in range(steps):
        loss, told = penalty(relief.moved().shape)
        loss.backward()
        adam.step(rate * min(1.0, 3 * (steps - step) / steps))
        print(step, {key: round(value, 4) for key, value in told.items()}, flush=True)
    _, told = penalty(relief.moved().shape)
    shapes = {"before": (piece.vertices, piece.faces), "after": relief.surface(relief.reached())}
    found = verdict.verify(shapes, piece.frame)["ratio"]["after"]
    moved = relief.offsets().detach().norm(dim=1) * piece.frame.mm_per_unit
    return {
        "told": {key: round(value, 4) for key, value in told.items()},
        "found": {key: round(found[key], 4) for key in MEASURES},
        "moved_mm": [round(float(moved.mean()), 3), round(float(moved.max()), 3)],
    }


if __name__ == "__main__":
    tyro.cli(main)

"""Small bodies and samples for the tests of the stress network."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch
import trimesh

from genmf_mi.sdf.distance import signed_distance
from genmf_mi.stress.data import codec
from genmf_mi.stress.data.dataset import FORMAT
from genmf_mi.stress.fem.simulation import Settings

N = 33


def ticks(n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """x, y and z of the grid [-1, 1]³, ``[n,n,n]`` each."""
    axis = np.linspace(-1, 1, n)
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    return x, y, z


def lopsided(n: int = N) -> torch.Tensor:
    """Two balls of different size that overlap, ``[1,n,n,n]``, without a symmetry."""
    x, y, z = ticks(n)
    one = np.sqrt((x - 0.1) ** 2 + (y + 0.2) ** 2 + (z + 0.3) ** 2) - 0.5
    two = np.sqrt((x + 0.2) ** 2 + (y - 0.4) ** 2 + (z - 0.1) ** 2) - 0.3
    return torch.tensor(np.minimum(one, two), dtype=torch.float32)[None]


def ball(stretch: tuple[float, float, float], n: int = N) -> np.ndarray:
    mesh = trimesh.creation.icosphere(subdivisions=3)
    return signed_distance(mesh.vertices * stretch, mesh.faces, n)


def write_samples(folder: Path, simulation: Settings | None = None) -> Path:
    """Balls whose stress rises with depth and towards the base: five for training, two for validation."""
    (folder / "samples").mkdir(parents=True)
    simulation = asdict(simulation or Settings(grid=N))
    (folder / "settings.json").write_text(json.dumps({"format": FORMAT, "simulation": simulation, "seed": 0}))
    records = []
    for index in range(7):
        rng = np.random.default_rng(index)
        layers, phi = codec.pack_distance(ball(tuple(rng.uniform(0.5, 0.9, 3))))
        height = np.linspace(1, 0, N)[None, :, None]
        layers |= codec.pack_stress(0.2 + height + np.abs(phi), phi)
        record = {
            "index": index,
            "file": f"samples/{index:06d}.npz",
            "shape": f"ball-{index // 2}",
            "family": "balls" if index < 4 else "others",
            "split": "train" if index < 5 else "validation",
            "relief_mm": [1.0, 4.0] if index % 2 else None,
        }
        np.savez_compressed(folder / record["file"], meta=np.array(json.dumps(record)), **layers)
        records.append(json.dumps(record) + "\n")
    (folder / "index.jsonl").write_text("".join(records))
    return folder

"""Reading a data set back for training."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from torch.utils.data import Dataset

from genmf_mi.errors import ConfigError
from genmf_mi.stress import codec
from genmf_mi.stress.dataset import read_index

SYMMETRIES = 8
"""Quarter turns about the vertical, each with and without a mirror image; the physics cannot tell them apart."""


def turned(field: np.ndarray, symmetry: int) -> np.ndarray:
    """``field [x,y,z]`` under one of the eight symmetries about the y axis; 0 leaves it as it is."""
    field = np.rot90(field, symmetry % 4, axes=(0, 2))
    return np.ascontiguousarray(field[::-1] if symmetry >= 4 else field)


class StressSamples(Dataset):
    """Pairs (Φ, von Mises in MPa), float32 ``[1,n,n,n]`` each, indexed x, y, z with y up; von Mises is 0 outside.

    Args:
        folder: what ``genmf-mi stress dataset --out`` wrote.
        split: ``train``, ``validation`` or ``test``. Variants of one shape are all in one split.
        augment: take each sample in one of its eight symmetries, at random from torch's generator.
        stride: keep every ``stride``-th sample of the grid, 2 makes 65³ of 129³.

    Raises:
        ConfigError: no such split, or no samples in it.
    """

    def __init__(self, folder: str | Path, split: str = "train", augment: bool = False, stride: int = 1) -> None:
        if split not in ("train", "validation", "test"):
            raise ConfigError(f"split must be train, validation or test, not {split!r}.")
        self.folder, self.augment, self.stride = Path(folder), augment, stride
        # Sorted, as several workers finish in no particular order.
        self.records = sorted(
            (r for r in read_index(self.folder) if "error" not in r and r["split"] == split), key=lambda r: r["index"]
        )
        if not self.records:
            raise ConfigError(
                f"{folder} holds no {split} samples; make some with `genmf-mi stress dataset --out {folder}`."
            )

    def __len__(self) -> int:
        return len(self.records)

    def arrays(self, item: int) -> tuple[np.ndarray, np.ndarray]:
        """Φ and von Mises as stored, float16 ``[n,n,n]``."""
        with np.load(self.folder / self.records[item]["file"]) as layers:
            n = layers["phi_far"].shape[0]
            phi = codec.unpack_distance(layers, n)
            return phi, codec.unpack_stress(layers, phi)

    def __getitem__(self, item: int) -> tuple[torch.Tensor, torch.Tensor]:
        symmetry = int(torch.randint(SYMMETRIES, ())) if self.augment else 0
        step = self.stride
        phi, stress = (
            torch.from_numpy(turned(field[::step, ::step, ::step], symmetry).astype(np.float32))[None]
            for field in self.arrays(item)
        )
        return phi, stress

"""Reading a data set back for training."""

from __future__ import annotations

import hashlib
import json
import zlib
from collections.abc import Callable
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
import torch
from torch.utils.data import Dataset

from genmf_mi.core.errors import ConfigError
from genmf_mi.core.files import atomic
from genmf_mi.sdf.redistance import redistance
from genmf_mi.stress.data import codec
from genmf_mi.stress.data.dataset import FORMAT, read_index
from genmf_mi.stress.fem.coarse import coarse_stress
from genmf_mi.stress.model.weights import settings_of, with_current_names

SYMMETRIES = 8
"""Quarter turns about the vertical, each with and without a mirror image; the physics is the same in all."""
DECODING = 1
"""Version of the decoded samples: one more when those of an older program would not fit this one."""


def apply_symmetry(field: np.ndarray, symmetry: int) -> np.ndarray:
    """``field [x,y,z]`` under one of the eight symmetries about the y axis; 0 leaves it as it is."""
    field = np.rot90(field, symmetry % 4, axes=(0, 2))
    return np.ascontiguousarray(field[::-1] if symmetry >= 4 else field)


class StressSamples(Dataset):
    """Pairs (Φ, von Mises in MPa), float32 ``[1,n,n,n]`` each, indexed x, y, z with y up; von Mises is 0 outside.

    Args:
        folder: the ``--out`` of ``genmf-mi stress dataset``.
        split: ``train``, ``validation`` or ``test``. Variants of one shape are all in one split.
        augment: take each sample in one of its eight symmetries, at random from torch's generator.
        stride: keep every ``stride``-th sample of the grid, 2 makes 65³ of 129³.
        cache: a folder for decoded samples (13 MB each at 129³), which are then mapped into memory: unpacking and
            redistancing one takes half a second, and its coarse stress three.
        coarse_mm: edge of the mesh for :meth:`with_coarse`, 0 for none.

    Raises:
        ConfigError: no such split, no samples in it, or the samples are of another format.
    """

    def __init__(
        self,
        folder: str | Path,
        split: str = "train",
        augment: bool = False,
        stride: int = 1,
        cache: str | Path | None = None,
        coarse_mm: float = 0.0,
    ) -> None:
        if split not in ("train", "validation", "test"):
            raise ConfigError(f"split must be train, validation or test, not {split!r}.")
        self.folder, self.augment, self.stride = Path(folder), augment, stride
        self.settings = read_settings(self.folder)
        # Sorted, as several workers finish in no particular order.
        self.records = sorted(
            (r for r in read_index(self.folder) if "error" not in r and r["split"] == split), key=lambda r: r["index"]
        )
        if not self.records:
            raise ConfigError(
                f"{folder} holds no {split} samples; make some with `genmf-mi stress dataset --out {folder}`."
            )
        digest = hashlib.sha256(json.dumps([DECODING, self.settings], sort_keys=True).encode()).hexdigest()[:16]
        self.cache = None if cache is None else Path(cache) / digest
        self.coarse_mm = coarse_mm
        self.simulation = settings_of(self.settings["simulation"])

    def __len__(self) -> int:
        return len(self.records)

    def arrays(self, item: int) -> tuple[np.ndarray, np.ndarray]:
        """Φ, :func:`genmf_mi.sdf.redistance.redistance`, and von Mises in MPa, float16 ``[n,n,n]``.

        Raises:
            OutputError: the cache cannot be written to. ConfigError: the sample's file is missing or damaged.
        """
        both = self._cached(item, "", lambda: np.stack(self._decoded(item)))
        return both[0], both[1]

    def coarse(self, item: int) -> np.ndarray:
        """Von Mises on a coarse mesh in MPa, float16 ``[n,n,n]``: see :func:`coarse.coarse_stress`.

        Raises:
            OutputError: the cache cannot be written to.
        """

        def solve() -> np.ndarray:
            phi = torch.from_numpy(self.arrays(item)[0].astype(np.float32))[None]
            return coarse_stress(phi, self.simulation, self.coarse_mm)[0].numpy().astype(np.float16)

        return self._cached(item, f"-{self.coarse_mm:g}", solve)

    def _cached(self, item: int, suffix: str, compute: Callable[[], np.ndarray]) -> np.ndarray:
        if self.cache is None:
            return compute()
        path = self.cache / f"{self.records[item]['index']:06d}{suffix}.npy"
        try:
            return np.load(path, mmap_mode="r")
        except (OSError, ValueError, EOFError):
            with atomic(path) as temporary:
                np.save(temporary, compute())
            return np.load(path, mmap_mode="r")

    def _decoded(self, item: int) -> tuple[np.ndarray, np.ndarray]:
        path = self.folder / self.records[item]["file"]
        try:
            with open(path, "rb") as handle, np.load(handle) as layers:
                n = layers["phi_far"].shape[0]
                phi = codec.unpack_distance(layers, n)
                return redistance(phi).astype(np.float16), codec.unpack_stress(layers, phi)
        except (OSError, KeyError, ValueError, EOFError, BadZipFile, zlib.error) as error:
            raise ConfigError(f"{path} cannot be read ({error}); make the data set again or restore it.") from error

    def __getitem__(self, item: int) -> tuple[torch.Tensor, torch.Tensor]:
        phi, stress = self._tensors(*self.arrays(item))
        return phi, stress

    def with_coarse(self, item: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor | None]:
        """Φ, von Mises, and :meth:`coarse`, None without ``coarse_mm``."""
        if not self.coarse_mm:
            return *self[item], None
        phi, stress, coarse = self._tensors(*self.arrays(item), self.coarse(item))
        return phi, stress, coarse

    def _tensors(self, *fields: np.ndarray) -> list[torch.Tensor]:
        """Strided, in one and the same symmetry, as float32 ``[1,n,n,n]``."""
        symmetry = int(torch.randint(SYMMETRIES, ())) if self.augment else 0
        step = self.stride
        return [
            torch.from_numpy(apply_symmetry(field[::step, ::step, ::step], symmetry).astype(np.float32))[None]
            for field in fields
        ]


def read_settings(folder: Path) -> dict:
    """What the samples of a folder share: see :meth:`genmf_mi.stress.data.dataset.DatasetSettings.record`.

    Raises:
        ConfigError: no data set, or one of another format.
    """
    path = folder / "settings.json"
    try:
        settings = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ConfigError(
            f"{folder} holds no data set ({path.name} cannot be read); make one with `genmf-mi stress dataset`."
        ) from error
    if not isinstance(settings, dict) or settings.get("format") != FORMAT:
        raise ConfigError(f"{folder} holds samples of another format than this program writes; make them again.")
    return {**settings, "simulation": with_current_names(settings["simulation"])}

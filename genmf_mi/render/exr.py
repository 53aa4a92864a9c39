"""The image buffers as OpenEXR files, for checking the numbers elsewhere."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR

from genmf_mi.core.files import atomic
from genmf_mi.render.bridge import Buffers
from genmf_mi.render.scene import View

_openexr: Any = OpenEXR  # it ships no types


def write_buffers(folder: str | Path, views: Sequence[View], buffers: Buffers) -> list[Path]:
    """One file per view, ``view_00.exr`` ..., with the float32 channels ``Y`` (grey), ``Z`` (depth), ``N.X``,
    ``N.Y``, ``N.Z`` and ``A`` (coverage).

    Raises:
        OutputError: a file cannot be written.
        ValueError: the scene was rendered without geometry buffers.
    """
    depth, normal, coverage = buffers.geometry
    paths: list[Path] = []
    for i, view in enumerate(views):
        tensors = {
            "Y": buffers.grey[i, 0],
            "Z": depth[i, 0],
            "A": coverage[i, 0],
            **{f"N.{axis}": normal[i, k] for k, axis in enumerate("XYZ")},
        }
        channels = {name: np.ascontiguousarray(x.cpu().numpy(), dtype=np.float32) for name, x in tensors.items()}
        header = {"compression": _openexr.ZIP_COMPRESSION, "type": _openexr.scanlineimage, "comments": view.label}
        path = Path(folder) / f"view_{i:02d}.exr"
        with atomic(path) as temporary:
            try:
                _openexr.File(header, channels).write(str(temporary))
            except RuntimeError as error:
                raise OSError(error) from error  # a full disk, as other writers report it
        paths.append(path)
    return paths

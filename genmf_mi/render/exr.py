"""The image buffers as OpenEXR files, for whoever wants to check the numbers."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from genmf_mi.core.files import atomic
from genmf_mi.render.bridge import Buffers
from genmf_mi.render.scene import View


def write_buffers(folder: str | Path, views: Sequence[View], buffers: Buffers) -> list[Path]:
    """One file per view, ``view_00.exr`` ..., with the float32 channels ``Y`` (grey), ``Z`` (depth), ``N.X``,
    ``N.Y``, ``N.Z`` and ``A`` (coverage). Raises :class:`OutputError`."""
    import OpenEXR

    paths = []
    for i, view in enumerate(views):
        channels = {
            "Y": buffers.grey[i, 0],
            "Z": buffers.depth[i, 0],
            "A": buffers.coverage[i, 0],
            **{f"N.{axis}": buffers.normal[i, k] for k, axis in enumerate("XYZ")},
        }
        channels = {name: np.ascontiguousarray(x.cpu().numpy(), dtype=np.float32) for name, x in channels.items()}
        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, "comments": view.label}
        path = Path(folder) / f"view_{i:02d}.exr"
        with atomic(path) as temporary:
            try:
                OpenEXR.File(header, channels).write(str(temporary))
            except RuntimeError as error:
                raise OSError(error) from error  # a full disk, as other writers report it
        paths.append(path)
    return paths

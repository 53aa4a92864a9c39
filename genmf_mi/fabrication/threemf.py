"""A part as 3MF, through lib3mf, the consortium's own library."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np


def write_3mf(path: Path, vertices: np.ndarray, faces: np.ndarray, title: str) -> None:
    """One object on the build plate.

    Args:
        vertices: ``[V,3]`` in millimetres, z up. faces: ``[F,3]``.
    """
    import lib3mf

    wrapper: Any = lib3mf.get_wrapper()
    model = wrapper.CreateModel()
    model.SetUnit(lib3mf.ModelUnit.MilliMeter)
    metadata = model.GetMetaDataGroup()
    metadata.AddMetaData("", "Title", title, "xs:string", True)
    metadata.AddMetaData("", "Application", "genmf_mi", "xs:string", True)
    mesh = model.AddMeshObject()
    mesh.SetName(title)
    mesh.SetGeometry(
        [lib3mf.Position((x, y, z)) for x, y, z in vertices.astype(np.float32).tolist()],
        [lib3mf.Triangle((a, b, c)) for a, b, c in faces.tolist()],
    )
    model.AddBuildItem(mesh, wrapper.GetIdentityTransform())
    # WriteToFile aborts the process when the disk is full
    path.write_bytes(bytes(model.QueryWriter("3mf").WriteToBuffer()))

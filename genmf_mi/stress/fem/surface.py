"""The closed surface that an asset file holds."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from genmf_mi.core.errors import AssetError


def load(path: str | Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices ``[V,3]`` (file units, y up) and faces ``[F,3]`` of the solid in an asset file.

    Raises:
        AssetError: the file is missing or unreadable. SolidError: it cannot be made solid.
    """
    from genmf_mi.assets.asset import load as load_asset
    from genmf_mi.mesh import solid

    if not Path(path).is_file():
        raise AssetError(f"{path} does not exist; check the path.")
    asset = load_asset(path)
    body = solid.solidify(asset.name, asset.vertices, asset.faces)
    return body.vertices, body.faces

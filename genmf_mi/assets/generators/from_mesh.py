"""From a textured mesh to Φ on a grid, so that both routes can be taken with any asset."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from genmf_mi.assets.asset import Asset
from genmf_mi.assets.sdf_asset import SdfAsset
from genmf_mi.core.frame import Frame
from genmf_mi.mesh import solid
from genmf_mi.sdf.distance import lost_fraction, signed_distance


def convert(asset: Asset, samples: int = 129, say: Callable[[str], None] = lambda text: None) -> SdfAsset:
    """The solid that the mesh route would refine, as an exact distance field; colours stay those of ``asset``.

    Args:
        samples: per axis. What is thinner than two cells may be lost: under ``report["lost_fraction"]`` of the surface.
        say: is told what is being done.

    Raises:
        SolidError: no solid can be made of it, or a grid this coarse sees nothing of it.
    """
    say("making it solid")
    body = solid.solidify(asset.name, asset.vertices, asset.faces)
    say(f"measuring distances on {samples}³ samples")
    frame = Frame.of(body.vertices, size_mm=1.0)
    vertices = frame.normalise(body.vertices)
    phi = signed_distance(vertices, body.faces, samples)
    return SdfAsset(
        asset.name,
        phi,
        centre=frame.centre,
        half=1 / frame.scale,
        coloured=asset,
        source=asset.source,
        report=body.report | {"lost_fraction": lost_fraction(vertices, np.asarray(body.faces), phi)},
    )

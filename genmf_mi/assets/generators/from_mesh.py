"""From a textured mesh to Φ on a grid, so that both routes can be taken with any asset."""

from __future__ import annotations

from genmf_mi.assets.asset import Asset
from genmf_mi.assets.sdf_asset import SdfAsset
from genmf_mi.core.frame import Frame
from genmf_mi.core.progress import Progress
from genmf_mi.mesh.solid import solidify
from genmf_mi.sdf.distance import signed_distance, thin_fraction


def sdf_from_mesh(asset: Asset, samples: int = 129, progress: Progress | None = None) -> SdfAsset:
    """The solid that the mesh route would refine, as an exact distance field; the colours stay those of ``asset``.

    Args:
        samples: per axis. Parts thinner than two cells may be lost; ``report["lost_fraction"]`` is their share of the
            surface.

    Raises:
        SolidError: no solid can be made of it, or the grid is too coarse for any of it.
    """
    progress = progress or Progress()
    progress.stage("making it solid")
    solid = solidify(asset.name, asset.vertices, asset.matter)
    progress.stage(f"measuring distances on {samples}³ samples")
    frame = Frame.of(solid.vertices, size_mm=1.0)
    vertices = frame.normalise(solid.vertices)
    phi = signed_distance(vertices, solid.faces, samples)
    return SdfAsset(
        asset.name,
        phi,
        centre=frame.centre,
        half=1 / frame.scale,
        coloured=asset,
        source=asset.source,
        report=solid.report | {"lost_fraction": thin_fraction(vertices, solid.faces, phi)},
    )

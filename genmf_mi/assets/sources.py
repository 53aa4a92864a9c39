"""What can be refined: files of meshes and of generators, bundled samples, and objects that are loaded already."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from genmf_mi.assets import asset as meshes
from genmf_mi.assets import samples
from genmf_mi.assets.asset import Asset
from genmf_mi.assets.generators import files
from genmf_mi.assets.samples import SDF_SUFFIX
from genmf_mi.assets.sdf_asset import SdfAsset
from genmf_mi.assets.suffixes import FIELDS
from genmf_mi.core.errors import AssetError


def load(
    source: str | Path | Asset | SdfAsset,
    textured: str | Path | Asset | None = None,
    up: str | None = None,
    *,
    files_anywhere: bool = False,
) -> Asset | SdfAsset:
    """The mesh, or the shape as Φ if ``source`` is a generator's file or a sample's name with ``_sdf`` appended.

    Args:
        textured: the mesh with the colours of a generator's file.
        up: the axis of a mesh's file that points upwards; files_anywhere: whether it may name files outside of its
            folder. See :func:`genmf_mi.assets.asset.load`.

    Raises:
        AssetError: as :func:`genmf_mi.assets.asset.load` and :func:`genmf_mi.assets.generators.files.load`; or
            ``textured`` is given for an asset that has its own colours.
    """
    if isinstance(source, SdfAsset | Asset):
        asset = source
    elif Path(source).suffix.lower() in FIELDS:
        if isinstance(textured, str | Path):
            textured = meshes.load(textured, files_anywhere=files_anywhere)
        return files.load(source, textured)
    elif str(source) in {name + SDF_SUFFIX for name in samples.NAMES} and not Path(source).exists():
        from genmf_mi.assets.generators import from_mesh

        mesh = meshes.load(samples.resolve(str(source).removesuffix(SDF_SUFFIX)))
        asset = replace(from_mesh.sdf_from_mesh(mesh), name=str(source))
    else:
        asset = meshes.load(samples.resolve(source), up, files_anywhere=files_anywhere)
    if textured is not None:
        raise AssetError(f"{asset.name} has its own colours: --textured is for the files of generators.")
    return asset

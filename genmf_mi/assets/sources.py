"""What can be refined: files of meshes and of generators, bundled samples, and objects that are loaded already."""

from __future__ import annotations

from pathlib import Path

from genmf_mi.assets import asset as meshes
from genmf_mi.assets import samples
from genmf_mi.assets.asset import Asset
from genmf_mi.assets.generators import files
from genmf_mi.assets.sdf_asset import SdfAsset
from genmf_mi.core.errors import AssetError

FIELD = "_sdf"
"""What is added to the name of a bundled sample to have it as Φ on a grid."""


def load(source: str | Path | Asset | SdfAsset, textured: str | Path | Asset | None = None) -> Asset | SdfAsset:
    """A mesh, or a shape as Φ if ``source`` is a generator's file or a sample's name with ``_sdf`` behind it.

    textured: the mesh that has the colours of a generator's file.

    Raises:
        AssetError: as :func:`genmf_mi.assets.asset.load` and :func:`genmf_mi.assets.generators.files.load`; or ``textured`` is given
            for what has its own colours.
    """
    if isinstance(source, SdfAsset | Asset):
        made = source
    elif Path(source).suffix.lower() in files.FORMATS:
        return files.load(source, textured)
    elif str(source) in {name + FIELD for name in samples.NAMES} and not Path(source).exists():
        from dataclasses import replace

        from genmf_mi.assets.generators.from_mesh import convert

        made = convert(meshes.load(samples.resolve(str(source).removesuffix(FIELD))))
        made = replace(made, name=str(source))
    else:
        made = meshes.load(samples.resolve(source))
    if textured is not None:
        raise AssetError(f"{made.name} has its own colours: --textured is for the files of generators.")
    return made

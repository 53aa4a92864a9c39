"""Objects made by this package's own code, whose detail is in the texture alone: something to refine at once.

Every sample is a smooth closed solid once its seams are welded, y up, its longest side 1, a file of its own beside this
one with ``charts()`` for the shape and ``paint(points, texel)`` for the colours.
"""

from __future__ import annotations

import os
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from genmf_mi.core.errors import AssetError
from genmf_mi.core.files import atomic

if TYPE_CHECKING:
    import trimesh

NAMES: tuple[str, ...] = ("strawberry", "watermelon", "ladybug", "globe", "leaf", "ball")


def make(name: str, resolution: int = 1024) -> trimesh.Trimesh:
    """The sample ``name`` with a base colour texture of ``resolution``² texels, the same in every bit each time.

    Vertices are split at the borders of the texture's charts.

    Raises:
        AssetError: there is no such sample.
    """
    if name not in NAMES:
        raise AssetError(f"there is no sample {name!r}. Choose one of {', '.join(NAMES)}.")
    from genmf_mi.assets.samples.charts import assemble

    sample = import_module(f"genmf_mi.assets.samples.{name}")
    return assemble(sample.charts(), sample.paint, resolution)


def write(name: str, folder: str | Path) -> Path:
    """Make ``folder/NAME.glb``, or leave it alone if it already holds just that. Returns its path.

    Raises:
        AssetError: there is no such sample.
        OutputError: the file cannot be written.
    """
    path = Path(folder) / f"{name}.glb"
    content = make(name).export(file_type="glb")
    if not (path.is_file() and path.read_bytes() == content):
        with atomic(path) as temporary:
            temporary.write_bytes(content)
    return path


def resolve(asset: str | Path) -> Path:
    """The file behind ``asset``: itself if it is one, else the bundled sample of that name, written to the cache.

    Raises:
        AssetError: neither a file nor a sample.
    """
    if Path(asset).is_file() or str(asset) not in NAMES:
        if not Path(asset).exists():
            raise AssetError(f"there is no file {asset}, and the bundled samples are {', '.join(NAMES)}.")
        return Path(asset)
    cache = Path(os.environ.get("GENMF_CACHE") or "~/.cache/genmf_mi").expanduser()
    return write(str(asset), cache / "samples")


def samples(out: Path = Path("samples")) -> None:
    """Write every bundled sample to a folder as GLB.

    Args:
        out: the folder.
    """
    from rich.progress import track

    for name in track(NAMES, description="samples"):
        print(write(name, out))

"""What benchmarks read and where their runs go: the options that all of them have in common."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

Needed = Literal["assets", "meshes", "data", "finer", "weights"]
"""Inputs that a benchmark may be unable to do without, by the names of :class:`Inputs`."""
EIGHT_ASSETS = (
    "hunyuan_bus",
    "sf3d_raccoon",
    "sf3d_garlic",
    "sf3d_schoolbus",
    "trellis_volcano",
    "instantmesh_chair",
    "spot",
    "teacup",
)
"""The textured assets of the README."""
FIVE_ASSETS = ("hunyuan_bus", "sf3d_raccoon", "sf3d_garlic", "trellis_volcano", "spot")
"""Those of the stress stage in docs/stress.md."""


@dataclass(frozen=True)
class Inputs:
    """Folders; a benchmark reads those that it needs."""

    assets: Path | None = None
    """Folder of textured assets, NAME.glb each. GENMF_TEST_ASSETS names it too."""
    names: tuple[str, ...] = ()
    """Only these of the assets or meshes; those of the published figures if not given."""
    meshes: Path | None = None
    """Folder of closed meshes, NAME.ply or another mesh format each."""
    data: Path | None = None
    """Data set for the stress network, as `genmf-mi stress dataset` writes it."""
    finer: Path | None = None
    """The test samples of that data set, simulated with --edge-mm 1.2."""
    weights: str = "compact"
    """The stress network: one of the package, or a file of weights."""
    out: Path = Path("runs/benchmarks")
    """Folder of the refinements; those that are finished there are not repeated."""

    def given(self, name: Needed) -> Path | None:
        """The path of that name, or None."""
        if name == "assets" and self.assets is None and os.environ.get("GENMF_TEST_ASSETS"):
            return Path(os.environ["GENMF_TEST_ASSETS"])
        return getattr(self, name)

    def require(self, name: Needed) -> Path:
        """The path of that name. Raises :class:`SystemExit` with a sentence where it is not given or not there."""
        path = self.given(name)
        if path is None or not path.exists():
            state = "is not given" if path is None else f"is not there: {path}"
            raise SystemExit(f"error: --{name} {state}. See `python -m benchmarks` for what each benchmark needs.")
        return path

    def asset_files(self, usual: tuple[str, ...]) -> list[Path]:
        """NAME.glb for each of ``names``, or of the ``usual`` ones."""
        folder = self.require("assets")
        return [folder / f"{name}.glb" for name in self.names or usual]

    def mesh_files(self, usual: tuple[str, ...] = ()) -> list[Path]:
        """The files of the folder ``meshes`` with one of ``names``, or of the ``usual`` ones; all if neither is given.

        Raises:
            SystemExit: one of them is not there.
        """
        from genmf_mi.stress.data.dataset import MESHES

        files = {path.stem: path for path in sorted(self.require("meshes").iterdir()) if path.suffix.lower() in MESHES}
        names = self.names or usual or tuple(files)
        if missing := [name for name in names if name not in files]:
            raise SystemExit(f"error: --meshes holds no mesh of the name {', '.join(missing)}.")
        return [files[name] for name in names]

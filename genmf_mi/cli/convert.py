"""``genmf-mi convert``: between meshes and SDF files, which hold Φ on a grid."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from genmf_mi.cli.arguments import call
from genmf_mi.core.errors import ConfigError, OutputError

if TYPE_CHECKING:
    from genmf_mi.assets.sdf_asset import SdfAsset
    from genmf_mi.core.progress import Progress

SDF, MESH, GRID = (".npz", ".safetensors"), (".glb",), (".vol",)
"""Suffixes that can be written: Φ with colours, the extracted mesh, Φ alone for Mitsuba's ``sdfgrid``."""
COARSEST = 17
"""Samples per axis of the smallest grid."""


def convert(
    asset: str,
    out: Path | None = None,
    samples: int = 129,
    textured: Path | None = None,
    files_anywhere: bool = False,
    force: bool = False,
    quiet: bool = False,
) -> int:
    """Turn a textured mesh into an SDF file, or an SDF file into the coloured mesh of its surface.

    Args:
        asset: A mesh file, the name of a bundled sample, or an SDF file (NPZ, safetensors or PT, also of a generator:
            see docs/generators.md).
        out: What to write; its suffix says what: .npz or .safetensors (SDF), .glb (mesh with vertex colours), .vol (for
            scenes with Mitsuba's sdfgrid). NAME.npz for a mesh and NAME.glb for an SDF file if not given.
        samples: Samples of the grid per axis, for a mesh; an SDF file keeps its own.
        textured: The same object as a mesh with colours, for an SDF file that has none or coarse ones.
        files_anywhere: Let the asset name textures, materials and buffers outside of its own folder.
        force: Replace an existing file.
        quiet: No progress, only the line at the end.
    """
    from genmf_mi.assets.samples import resolve
    from genmf_mi.assets.suffixes import FIELDS

    path = resolve(asset)
    from_mesh = path.suffix.lower() not in FIELDS
    out = out or Path(f"{path.stem}{SDF[0] if from_mesh else MESH[0]}")
    _check(path, out, samples, textured, from_mesh, force)
    from genmf_mi.cli.progress import TerminalProgress

    with TerminalProgress(quiet=quiet) as progress:
        progress.stage("reading")
        shape = _read(path, samples, textured, from_mesh, files_anywhere, progress)
        progress.stage("writing")
        result = _write(shape, out)
    print(result)
    return 0


def _check(path: Path, out: Path, samples: int, textured: Path | None, from_mesh: bool, force: bool) -> None:
    """Refuse what cannot work before anything is computed. Raises :class:`GenmfError`."""
    from genmf_mi.assets.sdf_asset import MAX_SAMPLES

    suffix, possible = out.suffix.lower(), (*SDF, *GRID) if from_mesh else (*SDF, *MESH, *GRID)
    if suffix in MESH and from_mesh:
        raise ConfigError(f"{path.name} is a mesh already; --out takes {', '.join(possible)}.")
    if suffix not in possible:
        raise ConfigError(f"{out} is of an unknown kind ({suffix or 'no suffix'}); --out takes {', '.join(possible)}.")
    if not COARSEST <= samples <= MAX_SAMPLES:
        raise ConfigError(f"--samples must be from {COARSEST} to {MAX_SAMPLES}, not {samples}.")
    if textured and from_mesh:
        raise ConfigError(f"{path.name} is a mesh and has its own colours: --textured goes with an SDF file.")
    if out.is_dir():
        raise OutputError(f"{out} is a folder. Choose another --out.")
    if out.exists() and out.samefile(path):
        raise OutputError(f"{out} is the asset itself. Choose another --out.")
    if out.exists() and not force:
        raise OutputError(f"{out} exists already. Use --force to replace it, or another --out.")


def _read(
    path: Path, samples: int, textured: Path | None, from_mesh: bool, files_anywhere: bool, progress: Progress
) -> SdfAsset:
    from genmf_mi.assets import asset as meshes
    from genmf_mi.assets import sources
    from genmf_mi.assets.generators.from_mesh import sdf_from_mesh

    if from_mesh:
        return sdf_from_mesh(meshes.load(path, files_anywhere=files_anywhere), samples, progress)
    shape = sources.load(path, textured, files_anywhere=files_anywhere)
    assert not isinstance(shape, meshes.Asset)
    return shape


def _write(shape: SdfAsset, out: Path) -> str:
    """Returns a line that says what was written."""
    from genmf_mi.assets.generators import files

    if out.suffix.lower() in SDF:
        return f"{files.save(shape, out)}: {_summary(shape)}"
    if out.suffix.lower() in MESH:
        return f"{out}: {_write_mesh(shape, out)}"
    return f"{out}: {_summary(shape)}\n{_write_grid(shape, out)}"


def _summary(shape: SdfAsset) -> str:
    line = f"{shape.resolution + 1}³ samples, {'with' if shape.textured else 'without'} colours"
    lost = shape.report.get("lost_fraction", 0.0)
    if lost < 0.0005:
        return line
    return f"{line}; {lost:.1%} of the surface is thinner than two cells and may be lost (more with --samples)"


def _write_mesh(shape: SdfAsset, out: Path) -> str:
    from genmf_mi.core.files import atomic
    from genmf_mi.fabrication.glb import write_glb
    from genmf_mi.mesh import topology

    mesh = shape.as_mesh()
    rgb = mesh.albedo.colours if shape.textured else None
    with atomic(out) as temporary:
        write_glb(temporary, mesh.vertices, mesh.faces, rgb, shape.name)
    closed, count = topology.is_closed(mesh.faces), int(topology.components(mesh.faces).max() + 1)
    return (
        f"{len(mesh.vertices)} vertices, {len(mesh.faces)} faces, {'with' if shape.textured else 'without'} colours, "
        f"{'closed' if closed else 'NOT closed'}, {count} {'component' if count == 1 else 'components'}"
    )


def _write_grid(shape: SdfAsset, out: Path) -> str:
    """Returns the call that renders it."""
    from genmf_mi.core.frame import Frame
    from genmf_mi.render import scene, sdf_scene, variant

    variant.use("auto")
    sdf_scene.write_grid(shape, out)
    placement = sdf_scene.placement(shape, Frame.of(shape.surface()[0], size_mm=1.0))
    settings = "".join(f', {name}="{value:.6g}"' for name, value in placement.items())
    xml = scene.find(shape.name, scene.GRID)
    return f'render it with mi.load_file("{xml}", grid="{out}"{settings}) after `import genmf_mi.plugins`'


def main(arguments: list[str]) -> int:
    """Read the arguments and convert."""
    return call(convert, "convert", arguments)

"""``genmf-mi stress simulate``."""

from __future__ import annotations

from pathlib import Path

from tyro.conf import Positional

from genmf_mi.cli.progress import TerminalProgress
from genmf_mi.core.files import claim_folder
from genmf_mi.stress.fem.protocol import Protocol


def simulate(
    asset: Positional[Path],
    /,
    out: Path | None = None,
    size_mm: float = 100.0,
    edge_mm: float = 1.6,
    grid: int = 129,
    material: str = "pla",
    protocol: Protocol = Protocol(),  # noqa: B008  (frozen)
    picture: bool = True,
    force: bool = False,
) -> None:
    """Simulate the thermal stress of a solid, and how it warps once it is off the bed; writes stress.vtu, stress.npz,
    stress.json and stress.png.

    Args:
        asset: A mesh file (made solid first), or a volume mesh such as .vtu or .msh with tetrahedra.
        out: Folder for the results; runs/NAME-stress if not given.
        size_mm: Longest side of the part.
        edge_mm: Side of the lattice that the tetrahedra come from; 1.2 or less to judge relief.
        grid: Samples per axis of the distance field that the shape is read from.
        material: pla, petg, abs or resin.
        protocol: What is simulated.
        picture: Render stress.png.
        force: Replace existing results.
    """
    from genmf_mi.cli.stress.shared import caption, simulate_file, warn_of_losses
    from genmf_mi.stress.fem.settings import Settings
    from genmf_mi.stress.fem.statistics import summary_with_warpage
    from genmf_mi.stress.report import output

    settings = Settings(size_mm, edge_mm, grid, material, protocol)
    out = out or Path("runs") / f"{asset.stem}-stress"
    claim_folder(out, "simulation", finished=output.FILES, force=force)
    with TerminalProgress() as progress:
        simulation = simulate_file(asset, settings, progress)
        numbers = {"asset": asset.name, **summary_with_warpage(simulation, progress)}
        progress.stage("writing")
        output.write_vtu(out / "stress.vtu", simulation.field)
        output.write_grid(out / "stress.npz", simulation)
        if picture:
            from genmf_mi.stress.report.picture import write_picture

            write_picture(out / "stress.png", [(caption(numbers), simulation)], asset.stem)
        output.write_json(out / "stress.json", numbers)
        warn_of_losses(asset, numbers, progress)
    print(f"{asset.name}: {caption(numbers)}; results in {out}")

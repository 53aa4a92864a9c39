"""What the commands about stress have in common."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from genmf_mi.core.progress import Progress

if TYPE_CHECKING:
    from genmf_mi.stress.fem.settings import Settings
    from genmf_mi.stress.fem.simulation import Simulation

THIN = 0.01
"""Share of the surface that may be thinner than two grid cells without a warning."""


def simulate_file(path: Path, settings: Settings, progress: Progress) -> Simulation:
    """Simulate a surface mesh, or a volume mesh as it is. Raises as :func:`genmf_mi.stress.fem.simulation.simulate`."""
    from genmf_mi.stress.fem import simulation, surface, volume_mesh

    progress.stage("reading")
    if volume_mesh.is_volume_mesh(path):
        return simulation.simulate_tetrahedra(volume_mesh.read(path), settings, progress=progress)
    return simulation.simulate(*surface.load(path), settings, progress=progress)


def caption(numbers: dict) -> str:
    """The figures of one shape in a line; ``numbers`` as in ``stress.json``."""
    stress, band = numbers["von_mises_mpa"], numbers["surface_band"]
    return (
        f"mean {stress['mean']:.3f} MPa, 99.9 % below {stress['p99_9']:.2f} MPa, "
        f"surface band {band['mean']:.3f} MPa"
        + (f", moves {numbers['displacement_max_mm']:.2f} mm" if "displacement_max_mm" in numbers else "")
        + (f", warps by {bent['flatness_mm']:.2f} mm off the bed" if (bent := numbers.get("warpage")) else "")
    )


def warn_of_losses(path: Path, numbers: dict, progress: Progress) -> None:
    """Warn where parts of the shape are not in the figures; ``numbers`` as in ``stress.json``."""
    mesh = numbers["mesh"]
    if numbers.get("warpage", True) is None:
        progress.warn(f"{path.name} has walls too thin for the mesh that its warpage is computed on; it was left out.")
    if mesh["thin_fraction"] > THIN:
        progress.warn(
            f"{path.name} is thinner than two grid cells under {mesh['thin_fraction']:.0%} of its surface, "
            "which is only partly in the figures; raise --grid and lower --edge-mm."
        )
    if mesh["dropped_bodies"]:
        progress.warn(
            f"{mesh['dropped_bodies']} loose components of {path.name} "
            f"({mesh['dropped_fraction']:.1%} of its volume) were left out."
        )

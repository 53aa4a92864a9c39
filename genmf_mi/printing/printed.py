"""A part as its printer makes it: sliced, and every bead that can be seen as a surface."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from genmf_mi.core.errors import ConfigError
from genmf_mi.core.printer import Printer
from genmf_mi.printing import slicer
from genmf_mi.printing.printability import printability
from genmf_mi.printing.slices import Slices
from genmf_mi.printing.sweep import Triangles, sweep
from genmf_mi.printing.visible import visible


@dataclass(frozen=True)
class Printed:
    """What comes off the printer.

    triangles: to look at, in the place and the frame of the part (mm, z up).
    slicer: its name. report: what it says (``print_seconds``, ``grams``, ``supports_share`` of all filament,
        ``warnings``), and ``layers``, ``triangles``, ``slicing_seconds`` and ``printability`` of ours.
    """

    triangles: Triangles
    slicer: str
    report: dict[str, Any] = field(default_factory=dict[str, Any])


def print_part(
    vertices: np.ndarray, faces: np.ndarray, printer: Printer, program: Path | None, folder: Path, name: str = "part"
) -> Printed:
    """Slice a closed part ``[V,3]``, ``[F,3]`` in mm, z up, on z = 0, and sweep its beads.

    Args:
        program: of the slicer, see :func:`genmf_mi.printing.slicer.find`; None for our own.
        folder: for the STL and the G-code, named ``name``.

    Raises:
        ConfigError: the printer has no layers, or its bed is too small. SolidError: the part is not closed.
        OutputError, SetupError: see :func:`genmf_mi.printing.slicer.slice_part`.
    """
    if not printer.layered:
        raise ConfigError(
            "only filament is printed in layers that can be seen: choose --printer fdm-0.2 or a finer one."
        )
    require_bed(vertices, printer)
    start = time.perf_counter()
    slices = Slices.of(vertices, faces, printer.layer_mm)
    report: dict[str, Any] = {
        "layers": len(slices.outlines),
        "printability": printability(vertices, faces, slices, printer),
    }
    if program is None:
        triangles = slices.printed(printer)
    else:
        triangles, said = _by_slicer(vertices, faces, printer, program, folder / f"{name}.stl", slices)
        report |= said
    report |= {"triangles": len(triangles.faces), "slicing_seconds": round(time.perf_counter() - start, 1)}
    return Printed(triangles, program.name if program else slicer.OWN, report)


def require_bed(vertices: np.ndarray, printer: Printer) -> None:
    """Raise :class:`ConfigError` if a part in mm does not fit the machine."""
    width, depth, height = (float(x) for x in np.ptp(vertices, axis=0))
    if not printer.fits((width, depth, height)):
        bed = " × ".join(f"{x:g}" for x in printer.bed_mm)
        raise ConfigError(
            f"the part is {width:.0f} × {depth:.0f} × {height:.0f} mm, larger than what the printer holds ({bed} mm). "
            "Make it smaller with --size-mm."
        )


def _by_slicer(
    vertices: np.ndarray, faces: np.ndarray, printer: Printer, program: Path, stl: Path, slices: Slices
) -> tuple[Triangles, dict[str, Any]]:
    from trimesh import Trimesh

    Trimesh(vertices, faces, process=False).export(stl)
    sliced = slicer.slice_part(program, stl, printer)
    middle = (vertices[:, :2].min(axis=0) + vertices[:, :2].max(axis=0)) / 2
    beads = sliced.gcode.moved(middle)
    shown = visible(beads, slices)
    outer = [bead for bead in shown if bead.role == "outer"]
    within = [bead for bead in shown if bead.role != "outer"]
    triangles = Triangles.joined([sweep(outer, printer.bulge), sweep(within, printer.bulge, segments=2)])
    return triangles, {
        "print_seconds": sliced.gcode.seconds,
        "grams": sliced.gcode.grams,
        "supports_share": _length(beads, "support") / max(_length(beads), 1e-9),
        "warnings": list(sliced.warnings),
    }


def _length(beads: list, role: str | None = None) -> float:
    """Of all beads, or of those of a role, in mm."""
    chosen = (bead.points for bead in beads if role in (None, bead.role))
    return float(sum(np.linalg.norm(np.diff(points, axis=0), axis=1).sum() for points in chosen))

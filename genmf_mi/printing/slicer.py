"""A slicer on this machine, run on the part as a print shop would."""

from __future__ import annotations

import re
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

from genmf_mi.core.errors import OutputError, SetupError
from genmf_mi.core.printer import Printer
from genmf_mi.printing import gcode

PROGRAMS = "prusa-slicer", "PrusaSlicer", "prusa-slicer-console", "superslicer"
"""Slicers with one and the same command line, in the order in which they are sought."""
OWN = "own"
"""Name of :mod:`genmf_mi.printing.slices` among the slicers."""
INSTALL = "Install PrusaSlicer (Debian: apt install prusa-slicer), name its program, or use --slicer own."
TIMEOUT = 600.0
"""Seconds."""
_PLA_DENSITY = 1.24


@dataclass(frozen=True)
class Sliced:
    """What the slicer made of a part, and what it warned of."""

    gcode: gcode.Gcode
    warnings: tuple[str, ...]


def find(name: str = "auto") -> Path | None:
    """The slicer's program: ``auto`` for the first that is installed, or a name or a path; None for our own, which is
    also what ``auto`` falls back to.

    Raises:
        SetupError: the program that was named is not there.
    """
    if name == OWN:
        return None
    for program in PROGRAMS if name == "auto" else (name,):
        if path := shutil.which(program):
            return Path(path)
    if name != "auto":
        raise SetupError(f"there is no slicer {name}. {INSTALL}")
    return None


def slice_part(program: Path, stl: Path, printer: Printer, *, timeout: float = TIMEOUT) -> Sliced:
    """Slice a part in millimetres, z up, with supports where it needs some; the G-code is written beside it.

    The middle of the part's bounding box is put above the origin.

    Raises:
        OutputError: the slicer fails, takes longer than ``timeout`` seconds, or its G-code is no good.
        SetupError: the program cannot be run.
    """
    out = stl.with_suffix(".gcode")
    try:
        done = subprocess.run(
            [str(program), *_arguments(printer), "--output", str(out), str(stl)],
            capture_output=True, text=True, errors="replace", timeout=timeout, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired as error:
        raise OutputError(f"{program.name} did not slice {stl.name} within {timeout:.0f} s. {INSTALL}") from error
    except OSError as error:
        raise SetupError(f"{program} cannot be run: {error.strerror}. {INSTALL}") from error
    said = done.stdout + done.stderr
    if done.returncode != 0 or not out.exists():
        raise OutputError(f"{program.name} does not slice {stl.name}: {_last_words(said)}")
    return Sliced(gcode.read(out), _warnings(said))


def _arguments(printer: Printer) -> list[str]:
    width, depth = (bed / 2 for bed in printer.bed_mm[:2])
    line = f"{printer.line_width_mm:g}"
    settings = {
        "layer-height": f"{printer.layer_mm:g}",
        "first-layer-height": f"{printer.layer_mm:g}",
        "nozzle-diameter": f"{printer.smallest_feature_mm:g}",
        "external-perimeter-extrusion-width": line,
        "perimeter-extrusion-width": line,
        "perimeters": "2",
        "fill-density": "10%",
        "top-solid-layers": "5",
        "bottom-solid-layers": "4",
        "skirts": "0",
        "elefant-foot-compensation": "0",
        "filament-diameter": "1.75",
        "filament-density": f"{_PLA_DENSITY:g}",
        "support-material-threshold": "45",
        "max-print-height": f"{printer.bed_mm[2]:g}",
        "bed-shape": f"{-width:g}x{-depth:g},{width:g}x{-depth:g},{width:g}x{depth:g},{-width:g}x{depth:g}",
        "center": "0,0",
        "loglevel": "2",
    }
    return ["--export-gcode", "--support-material", *(f"--{key}={value}" for key, value in settings.items())]


def _warnings(said: str) -> tuple[str, ...]:
    """The lines of warning, each once, without time stamps."""
    lines = (re.sub(r"^\[.*?\]\s*(\[.*?\]\s*)*", "", line).strip() for line in said.splitlines() if _is_warning(line))
    return tuple(dict.fromkeys(line for line in lines if line))


def _is_warning(line: str) -> bool:
    return "warning" in line.lower() and "trace" not in line


def _last_words(said: str) -> str:
    lines = [line.strip() for line in said.splitlines() if line.strip() and "[trace]" not in line]
    return lines[-1] if lines else "it says nothing. Look at the part in the slicer itself."

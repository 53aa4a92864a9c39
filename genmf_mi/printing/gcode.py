"""G-code of PrusaSlicer, SuperSlicer, OrcaSlicer and Bambu Studio, read back as the beads that it extrudes."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from genmf_mi.core.errors import OutputError
from genmf_mi.printing.paths import Bead, Role

_ROLES: dict[str, Role] = {
    **dict.fromkeys(("external perimeter", "overhang perimeter", "outer wall", "overhang wall"), "outer"),
    **dict.fromkeys(("perimeter", "inner wall", "gap fill", "gap infill", "thin wall"), "inner"),
    **dict.fromkeys(
        ("solid infill", "top solid infill", "bridge infill", "internal infill", "internal bridge infill", "ironing",
         "internal solid infill", "top surface", "bottom surface", "bridge", "internal bridge", "sparse infill"),
        "fill",
    ),
}  # fmt: skip
"""What the slicers call their extrusions; all else is beside the part."""
_CLOSED_GAP_MM = 0.6
"""Slicers stop a loop short of its start, so that the seam does not swell."""


@dataclass(frozen=True)
class Gcode:
    """The beads of a file, and what the slicer says at its end; 0 where it does not say."""

    beads: list[Bead]
    seconds: float
    grams: float
    filament_mm: float

    def moved(self, by_mm: np.ndarray) -> list[Bead]:
        """The beads, shifted by ``[2]``."""
        return [replace(bead, points=bead.points + by_mm) for bead in self.beads]


def read(path: str | Path) -> Gcode:
    """Read a file of G-code.

    Raises:
        OutputError: the file cannot be read, ends too early, or extrudes nothing.
    """
    try:
        text = Path(path).read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise OutputError(f"{path} cannot be read: {error.strerror}.") from error
    reader = _Reader()
    for line in text.splitlines():
        reader.line(line)
    reader.end_path()
    if not reader.beads:
        raise OutputError(f"{path} extrudes nothing. Look at the part in the slicer itself.")
    grams = _figure(text, r"; (?:total )?filament used \[g\]\s*[=:]\s*([\d.]+)")
    filament = _figure(text, r"; (?:total )?filament used \[mm\]\s*[=:]\s*([\d.]+)")
    if not filament and not re.search(r"^M84|^; (CONFIG_BLOCK_END|prusaslicer_config = end)", text, re.MULTILINE):
        raise OutputError(f"{path} is cut off: the slicer stopped before the end of the print.")
    return Gcode(reader.beads, _seconds(text), grams, filament)


class _Reader:
    """Follows the nozzle line by line."""

    def __init__(self) -> None:
        self.beads: list[Bead] = []
        self._position = [0.0, 0.0, 0.0]
        self._relative, self._extruded = False, 0.0
        self._kind, self._width, self._height = "", 0.45, 0.2
        self._points: list[tuple[float, float]] = []
        self._widths: list[float] = []

    def line(self, line: str) -> None:
        if line.startswith(";"):
            self._comment(line[1:].strip())
        elif line.startswith(("G1 ", "G0 ", "G2 ", "G3 ")):
            self._move(line.partition(";")[0])
        elif line.startswith("M83"):
            self._relative = True
        elif line.startswith("M82"):
            self._relative = False
        elif line.startswith("G92") and (match := re.search(r"E(-?[\d.]+)", line)):
            self._extruded = float(match[1])

    def _comment(self, text: str) -> None:
        key, _, value = text.partition(":")
        key, value = key.strip().upper(), value.strip()
        if key in ("TYPE", "FEATURE"):
            self.end_path()
            self._kind = value.lower()
        elif key in ("WIDTH", "LINE_WIDTH"):
            self._width = float(value)
        elif key in ("HEIGHT", "LAYER_HEIGHT"):
            self.end_path()
            self._height = float(value)

    def _move(self, line: str) -> None:
        x, y, z = self._position
        extruded = 0.0
        for word in line.split()[1:]:
            axis, number = word[0], word[1:]
            if axis == "X":
                x = float(number)
            elif axis == "Y":
                y = float(number)
            elif axis == "Z":
                z = float(number)
            elif axis == "E":
                extruded = float(number) - (0.0 if self._relative else self._extruded)
                self._extruded = 0.0 if self._relative else float(number)
        before = self._position
        moved = x != before[0] or y != before[1]
        if z != before[2] or (moved and extruded <= 0):
            self.end_path()
        self._position = [x, y, z]
        if moved and extruded > 0:
            if not self._points:
                self._points, self._widths = [(before[0], before[1])], [self._width]
            self._points.append((x, y))
            self._widths.append(self._width)

    def end_path(self) -> None:
        """Keep what was extruded without a break."""
        if len(self._points) > 1:
            points, width = np.array(self._points), np.array(self._widths)
            role = _ROLES.get(self._kind, "support")
            gap = float(np.hypot(*(points[0] - points[-1])))
            closed = len(points) > 3 and role in ("outer", "inner") and gap < _CLOSED_GAP_MM
            if closed and gap < 1e-3:
                points, width = points[:-1], width[:-1]
            self.beads.append(Bead(points, width, self._position[2], self._height, role, closed))
        self._points, self._widths = [], []


def _figure(text: str, pattern: str) -> float:
    found = re.search(pattern, text)
    return float(found[1]) if found else 0.0


def _seconds(text: str) -> float:
    """Of ``; estimated printing time (normal mode) = 1d 2h 3m 4s``, or how OrcaSlicer says it."""
    found = re.search(r"; (?:estimated printing time \(normal mode\) =|.*total estimated time:)\s*([\ddhms ]+)", text)
    units = {"d": 86400, "h": 3600, "m": 60, "s": 1}
    return float(sum(int(n) * units[u] for n, u in re.findall(r"(\d+)([dhms])", found[1]))) if found else 0.0

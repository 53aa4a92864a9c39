"""A slicer on this machine: found, missing, failing, too slow, cut off; and the real one where it is installed."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from test_gcode import PRUSA

from genmf_mi.core.errors import ConfigError, OutputError, SetupError
from genmf_mi.core.printer import PRINTERS
from genmf_mi.printing import slicer
from genmf_mi.printing.printed import print_part

PRINTER = PRINTERS["fdm-0.2"]


def pretended(folder: Path, body: str) -> Path:
    """A program that does ``body`` with the arguments of a slicer in ``args``."""
    program = folder / "prusa-slicer"
    program.write_text(f"#!{sys.executable}\nimport sys, time, pathlib\nargs = sys.argv\n{body}\n")
    program.chmod(0o755)
    return program


WRITE = "pathlib.Path(args[args.index('--output') + 1]).write_text({!r})\n"


class TestFind:
    def test_none_is_no_error_unless_it_was_named(self, monkeypatch, tmp_path):
        monkeypatch.setenv("PATH", str(tmp_path))
        assert slicer.find() is None
        with pytest.raises(SetupError, match=r"no slicer /nowhere/slic3r.*--slicer own"):
            slicer.find("/nowhere/slic3r")
        program = pretended(tmp_path, "")
        assert slicer.find() == program == slicer.find(str(program))


class TestSlicePart:
    def test_reads_what_it_writes_and_says(self, tmp_path):
        body = WRITE.format(PRUSA) + "print('[2026-01-01 10:00] [0x1] [warning]   Loose extrusions')"
        sliced = slicer.slice_part(pretended(tmp_path, body), tmp_path / "part.stl", PRINTER)
        assert len(sliced.gcode.beads) == 4
        assert sliced.warnings == ("Loose extrusions",)

    @pytest.mark.parametrize(
        ("body", "message"),
        [
            (
                "print('Objects could not fit'); sys.exit(1)",
                "does not slice part.stl: Objects could not fit",
            ),
            ("pass", "does not slice"),
            (WRITE.format(PRUSA[:200]), "cut off"),
            (WRITE.format(""), "extrudes nothing"),
        ],
    )
    def test_failures(self, tmp_path, body, message):
        with pytest.raises(OutputError, match=message):
            slicer.slice_part(pretended(tmp_path, body), tmp_path / "part.stl", PRINTER)

    def test_too_slow(self, tmp_path):
        with pytest.raises(OutputError, match=r"did not slice part.stl within 1 s.*--slicer own"):
            slicer.slice_part(pretended(tmp_path, "time.sleep(20)"), tmp_path / "part.stl", PRINTER, timeout=1)

    def test_not_a_program(self, tmp_path):
        program = tmp_path / "prusa-slicer"
        program.write_text("no program")
        with pytest.raises(SetupError, match="cannot be run"):
            slicer.slice_part(program, tmp_path / "part.stl", PRINTER)


def part(size: float = 12.0) -> tuple[np.ndarray, np.ndarray]:
    ball = trimesh.creation.icosphere(4, radius=size / 2)
    return ball.vertices + np.array([30, 5, size / 2]), np.array(ball.faces)


class TestPrintPart:
    def test_without_a_slicer(self, tmp_path):
        vertices, faces = part()
        printed = print_part(vertices, faces, PRINTER, None, tmp_path)
        assert printed.slicer == slicer.OWN and printed.report["layers"] == 60
        np.testing.assert_allclose(printed.triangles.vertices.min(axis=0), vertices.min(axis=0), atol=0.1)
        np.testing.assert_allclose(printed.triangles.vertices.max(axis=0), vertices.max(axis=0), atol=0.1)

    def test_a_printer_without_layers_and_a_small_bed(self, tmp_path):
        with pytest.raises(ConfigError, match=r"fdm-0\.2"):
            print_part(*part(), PRINTERS["smooth"], None, tmp_path)
        with pytest.raises(ConfigError, match=r"300 × 300 × 300 mm.*--size-mm"):
            print_part(*part(300.0), PRINTER, None, tmp_path)

    @pytest.mark.skipif(slicer.find() is None, reason="no slicer is installed")
    def test_the_real_slicer_agrees_with_ours(self, tmp_path):
        """In place, size and height, and in the area that is seen from above."""
        vertices, faces = part()
        real = print_part(vertices, faces, PRINTER, slicer.find(), tmp_path)
        own = print_part(vertices, faces, PRINTER, None, tmp_path)
        for end in (np.min, np.max):
            found, expected = (end(p.triangles.vertices, axis=0) for p in (real, own))
            np.testing.assert_allclose(found, expected, atol=0.15)
        assert real.report["grams"] > 0.1 and real.report["print_seconds"] > 60
        assert real.report["supports_share"] > 0

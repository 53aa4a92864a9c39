"""Whether a part can be printed, in the words that slicers use, and why not."""

from __future__ import annotations

from typing import Any

import numpy as np

from genmf_mi.core.printer import Printer
from genmf_mi.fabrication.checks import min_thickness
from genmf_mi.geometry.laplacian import cotangent_laplacian
from genmf_mi.mesh.measures import face_areas, face_normals, vertex_areas
from genmf_mi.printing.slices import Slices

READY, LOOK, NOT_PRINTABLE = "ready", "look at", "not printable"

STEEPEST_OVERHANG = 45.0
"""Degrees from the vertical up to which a wall carries itself."""
SMALLEST_CONTACT_MM2 = 100.0
"""First layer below which a part wants a brim, so that it stays on the bed."""
SUPPORTED_SHARE, THIN_SHARE, LOST_SHARE = 0.05, 0.005, 0.1
"""Shares of the surface that hangs over and of the outlines that are too thin from which on they are worth a look, and
of the outlines from which on there is no part left."""


def printability(vertices: np.ndarray, faces: np.ndarray, slices: Slices, printer: Printer) -> dict[str, Any]:
    """What to know of a part in mm, z up, on z = 0, before anybody spends filament on it.

    Returns:
        ``verdict``: ready, look at, or not printable; ``reasons``: of the last two, in words;
        ``first_layer_mm2``; ``floating_parts``: pieces of layers with nothing below them; ``overhang_mm2`` and
        ``overhang_share`` of the surface; ``too_thin_mm2``, of all outlines, where the nozzle does not fit;
        ``min_thickness_mm``, see :func:`genmf_mi.fabrication.checks.min_thickness`;
        ``mean_curvature_per_mm``: p50, p95 and p99 of its size over the area.
    """
    overhang = overhang_mm2(vertices, faces, slices.layer_mm)
    report = {
        "first_layer_mm2": float(slices.outlines[0].area()),
        "floating_parts": floating_parts(slices),
        "overhang_mm2": overhang,
        "overhang_share": overhang / float(face_areas(vertices, faces).sum()),
        "too_thin_mm2": float(slices.too_thin_mm2(printer.smallest_feature_mm)),
        "min_thickness_mm": min_thickness(vertices, faces),
        "mean_curvature_per_mm": curvature(vertices, faces),
    }
    reasons = _reasons(report, slices.area_mm2, printer)
    lost = report["first_layer_mm2"] == 0 or report["too_thin_mm2"] > LOST_SHARE * slices.area_mm2
    return {"verdict": NOT_PRINTABLE if lost else LOOK if reasons else READY, "reasons": reasons, **report}


def overhang_mm2(vertices: np.ndarray, faces: np.ndarray, layer_mm: float) -> float:
    """Area of the surface that cannot carry itself, of a part in mm, z up, but for its first layer."""
    normals, areas = face_normals(vertices, faces), face_areas(vertices, faces)
    on_bed = vertices[faces][..., 2].max(axis=1) < vertices[:, 2].min() + layer_mm
    return float(areas[(normals[:, 2] < -np.sin(np.radians(STEEPEST_OVERHANG))) & ~on_bed].sum())


def floating_parts(slices: Slices) -> int:
    """Pieces of the layers that have nothing below them, and are not on the bed."""
    count = 0
    for below, here in zip(slices.outlines, slices.outlines[1:], strict=False):
        pieces = here.decompose()
        if len(pieces) > len(below.decompose()) or below.is_empty():
            count += sum((piece ^ below).is_empty() for piece in pieces)
    return count


def curvature(vertices: np.ndarray, faces: np.ndarray) -> dict[str, float]:
    """Percentiles over the area of the size of the mean curvature, |L x| / 2A with the cotangent Laplacian (Meyer et
    al. 2003), in 1/mm."""
    areas = vertex_areas(vertices, faces)
    size = np.linalg.norm(cotangent_laplacian(vertices, faces) @ vertices, axis=1) / np.maximum(2 * areas, 1e-12)
    order = np.argsort(size)
    share = np.cumsum(areas[order]) / areas.sum()
    return {f"p{p}": float(size[order][np.searchsorted(share, p / 100)]) for p in (50, 95, 99)}


def _reasons(report: dict[str, Any], outlines_mm2: float, printer: Printer) -> list[str]:
    """What is worth a look, in words."""
    reasons: list[str] = []
    if report["first_layer_mm2"] < SMALLEST_CONTACT_MM2:
        reasons.append(
            f"the first layer is {report['first_layer_mm2']:.1f} mm² only: use a brim, or cut a flat into the base"
        )
    if count := report["floating_parts"]:
        pieces = "piece of a layer starts" if count == 1 else "pieces of layers start"
        reasons.append(f"{count} {pieces} in the air: switch supports on")
    if report["overhang_share"] > SUPPORTED_SHARE:
        reasons.append(
            f"{report['overhang_share']:.0%} of the surface hangs over: switch supports on, or turn the part"
        )
    if report["too_thin_mm2"] > THIN_SHARE * outlines_mm2:
        share = report["too_thin_mm2"] / outlines_mm2
        reasons.append(f"{share:.1%} of the outlines are thinner than the nozzle and will be left out: make it larger")
    if report["min_thickness_mm"] < printer.smallest_wall_mm:
        reasons.append(
            f"walls are as thin as {report['min_thickness_mm']:.1f} mm, and two lines need "
            f"{printer.smallest_wall_mm:g} mm: they may break, so make it larger"
        )
    return reasons

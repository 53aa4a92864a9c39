"""The mesh of the 3D view, packed for a page: quantised, ordered along a space-filling curve, differenced, deflated.

Layout: one zlib stream of columns of equal integers. A column is differenced along its length, folded to unsigned
(0, -1, 1, -2, … → 0, 1, 2, 3, …) and stored byte plane by byte plane, lowest byte first. ``viewer.js`` undoes it.

Columns, in this order: refined x, y, z (in steps of ``step`` from ``low``); original minus refined x, y, z (only with
an original); colours r, g, b (sRGB bytes); relief (in steps of ``reliefStep`` mm); indices.
"""

from __future__ import annotations

import base64
import zlib
from dataclasses import dataclass

import numpy as np

from genmf_mi.core.colour import to_srgb
from genmf_mi.report.model import Report

MAX_FACES = 600_000
"""Meshes with more faces are simplified for the 3D view."""

_LEVELS = 65535
_RELIEF_LEVELS = 127


@dataclass(frozen=True)
class Packed:
    """A packed mesh: ``meta`` goes into the page as JSON, ``data`` as text (base64)."""

    meta: dict
    data: str


def pack(report: Report) -> Packed:
    """Pack a report's mesh: positions to 1/65535 of the longest side, relief to 1/127 of the cap, 8-bit colours."""
    shapes = [np.asarray(report.vertices, dtype=np.float64)]
    if report.original is not None:
        shapes.append(np.asarray(report.original, dtype=np.float64))
    low = np.min([shape.min(axis=0) for shape in shapes], axis=0)
    high = np.max([shape.max(axis=0) for shape in shapes], axis=0)
    step = max(float((high - low).max()), 1e-12) / _LEVELS
    faces = np.asarray(report.faces, dtype=np.int64)
    azimuth = _best_azimuth(shapes[0], faces, report.relief_mm)

    keep = np.arange(len(shapes[0]))
    if len(faces) > MAX_FACES:
        keep, group, faces = _merge(np.round((shapes[0] - low) / step).astype(np.int64), faces)
        shapes = [_means(shape, group, len(keep)) for shape in shapes]
    position, *original = (np.round((shape - low) / step).astype(np.int64) for shape in shapes)
    order = np.argsort(_morton(position), kind="stable")
    keep, residual = keep[order], [(shape - position)[order] for shape in original]
    position = position[order]
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order))

    columns = [column for shape in [position, *residual] for column in shape.T]
    columns += list(np.round(to_srgb(np.clip(report.colours[keep], 0, 1)) * 255).astype(np.int64).T)
    range_mm = float(report.cap_mm) or 1.0
    relief = np.clip(np.nan_to_num(np.asarray(report.relief_mm)[keep]) / range_mm, -1, 1)
    columns += [np.round(relief * _RELIEF_LEVELS).astype(np.int64), _ordered(rank[faces]).ravel()]

    packed = [_fold(column) for column in columns]
    meta = {
        "vertices": len(keep),
        "faces": len(faces),
        "low": [float(x) for x in low],
        "step": step,
        "reliefStep": range_mm / _RELIEF_LEVELS,
        "rangeMm": range_mm,
        "hasOriginal": report.original is not None,
        "widths": [len(planes) for planes in packed],
        "azimuth": azimuth,
    }
    stream = b"".join(planes.tobytes() for planes in packed)
    return Packed(meta, base64.b64encode(zlib.compress(stream, 6)).decode("ascii"))


def _fold(column: np.ndarray) -> np.ndarray:
    """Difference, fold the sign, and split into byte planes, ``[width, N]``."""
    delta = np.diff(column, prepend=0)
    folded = np.where(delta < 0, -2 * delta - 1, 2 * delta).astype("<u4")
    width = max(1, -(-int(folded.max(initial=0)).bit_length() // 8))
    return folded.view(np.uint8).reshape(-1, 4).T[:width]


def _morton(position: np.ndarray) -> np.ndarray:
    """Morton codes of 16-bit integer positions ``[N,3]``: sorted by them, neighbours in space are close in the file."""
    code = np.zeros(len(position), dtype=np.int64)
    for bit in range(16):
        for axis in range(3):
            code |= ((position[:, axis] >> bit) & 1) << (3 * bit + axis)
    return code


def _ordered(faces: np.ndarray) -> np.ndarray:
    """Faces turned so that the lowest index comes first, then sorted; the orientation stays."""
    start = faces.argmin(axis=1)
    faces = np.take_along_axis(faces, (start[:, None] + np.arange(3)) % 3, axis=1)
    return faces[np.lexsort((faces[:, 1], faces[:, 0]))]


def _merge(position: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Merge the vertices in each cell of ever coarser grids until at most :data:`MAX_FACES` faces are left.

    Returns:
        one vertex of each cell, the cell of every vertex, and the faces between cells.
    """
    cell = 128
    while True:
        x, y, z = (position // cell).T
        _, keep, group = np.unique((x << 32) | (y << 16) | z, return_index=True, return_inverse=True)
        a, b, c = group[faces].T
        merged = group[faces][(a != b) & (b != c) & (c != a)]
        if len(merged) <= MAX_FACES:
            return keep, group, merged
        cell = cell * 5 // 4


def _means(values: np.ndarray, group: np.ndarray, count: int) -> np.ndarray:
    """Mean of ``values`` ``[N,3]`` over each of ``count`` groups."""
    size = np.bincount(group, minlength=count)
    return np.stack([np.bincount(group, column, count) / size for column in values.T], axis=1)


def _best_azimuth(vertices: np.ndarray, faces: np.ndarray, relief_mm: np.ndarray) -> int:
    """The azimuth in degrees (0 looks at +z, 90 at +x) from which most relief faces the viewer."""
    from genmf_mi.mesh.measures import face_areas, face_normals  # libigl takes 0.2 s to import

    normal = face_normals(vertices, faces) * face_areas(vertices, faces)[:, None]
    weight = np.abs(np.nan_to_num(np.asarray(relief_mm)))[faces].mean(axis=1)
    azimuths = np.arange(0, 360, 30)
    angle = np.radians(azimuths)
    facing = np.outer(normal[:, 0], np.sin(angle)) + np.outer(normal[:, 2], np.cos(angle))
    return int(azimuths[(np.clip(facing, 0, None) * weight[:, None]).sum(axis=0).argmax()])

"""Painted regions as the page sends them, checked before a process is started for them."""

from __future__ import annotations

from math import isfinite
from typing import Any

from genmf_mi.core.errors import ConfigError

FORMAT, VERSION = "genmf-regions", 1
KINDS = ("flat", "stronger", "matters", "erase")
MAX_STROKES, MAX_POINTS = 5000, 200_000


def checked(regions: object) -> dict[str, Any] | None:
    """The regions, or None if there are none.

    Raises:
        ConfigError: they are not as docs/http_api.md describes them.
    """
    if regions is None:
        return None
    if not isinstance(regions, dict) or regions.get("format") != FORMAT or regions.get("version") != VERSION:
        raise ConfigError(f'regions must have "format": "{FORMAT}" and "version": {VERSION}.')
    strokes = regions.get("strokes")
    if not isinstance(strokes, list) or len(strokes) > MAX_STROKES:
        raise ConfigError(f"regions must have up to {MAX_STROKES} strokes.")
    if not strokes:
        return None
    count = sum(_points(stroke) for stroke in strokes)
    if count > MAX_POINTS:
        raise ConfigError(f"regions have {count} points; up to {MAX_POINTS} can be used.")
    return {"format": FORMAT, "version": VERSION, "strokes": strokes}


def _points(stroke: Any) -> int:
    """The number of points of a stroke. Raises :class:`ConfigError`."""
    if not isinstance(stroke, dict) or stroke.get("kind") not in KINDS:
        raise ConfigError(f"a stroke must be of a kind of {', '.join(KINDS)}.")
    for name in ("radius_mm", "factor"):
        value = stroke.get(name, 1.0)
        if not isinstance(value, (int, float)) or not (isfinite(value) and value > 0):
            raise ConfigError(f"{name} of a stroke must be positive.")
    points, normals = stroke.get("points"), stroke.get("normals")
    if not (isinstance(points, list) and isinstance(normals, list) and points and len(points) == len(normals)):
        raise ConfigError("a stroke must have as many normals as points.")
    for vector in (*points, *normals):
        good = isinstance(vector, list) and len(vector) == 3
        if not good or not all(isinstance(x, (int, float)) and isfinite(x) for x in vector):
            raise ConfigError("points and normals of a stroke must be three numbers each.")
    return len(points)

"""Painted regions as the page sends them, checked before a process is started for them."""

from __future__ import annotations

import json
from typing import Any

from genmf_mi.core.errors import ConfigError
from genmf_mi.core.regions import KINDS, Regions

__all__ = ["KINDS", "checked"]

MAX_STROKES, MAX_POINTS = 5000, 200_000


def checked(regions: object) -> dict[str, Any] | None:
    """The regions, or None if there are none.

    Raises:
        ConfigError: they are not as docs/regions.md describes them, or too many.
    """
    if regions is None or (isinstance(regions, dict) and regions.get("strokes") == []):
        return None
    strokes = Regions.from_json(json.dumps(regions), "the request").strokes
    count = sum(len(stroke.points) for stroke in strokes)
    if len(strokes) > MAX_STROKES or count > MAX_POINTS:
        raise ConfigError(f"the request has {len(strokes)} strokes of {count} points, which is too much to work with.")
    assert isinstance(regions, dict)
    return regions

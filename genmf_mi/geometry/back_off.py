"""Take relief back where it made the surface cut through itself."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

ROUNDS = 12
REACH = 3
"""Rings of neighbours that give way together with a crossing face."""


def untangle(
    base: np.ndarray, faces: np.ndarray, offsets: np.ndarray, crossings: Callable[[np.ndarray, np.ndarray], np.ndarray]
) -> tuple[np.ndarray, dict]:
    """Scale ``offsets [V,3]`` down around faces that cross others in ``base + offsets`` but not in ``base``.

    crossings: from vertices and faces to the indices of crossing faces. Returns the offsets and a report with the
    numbers of crossing faces before, at first and in the end. After half of the rounds the remaining spots are given
    up and stay as they were.
    """
    before = len(crossings(base, faces))
    scale = np.ones(len(base))
    first = None
    for attempt in range(ROUNDS):
        crossing = crossings(base + scale[:, None] * offsets, faces)
        first = len(crossing) if first is None else first
        if len(crossing) <= before:
            break
        rings = _rings(faces, np.unique(faces[crossing]), REACH, len(base))
        give_way = 0.5 if attempt < ROUNDS // 2 else 0.0
        # The ring next to the spot gives way most, so that no new edge appears at its rim
        for ring, vertices in enumerate(rings):
            share = ring / (REACH + 1)
            scale[vertices] *= give_way + (1 - give_way) * share
    else:
        crossing = crossings(base + scale[:, None] * offsets, faces)
    if len(crossing) > before:
        scale[:] = 0
    report = {"self_intersections_before": before, "untangled": first, "vertices_held_back": int((scale < 1).sum())}
    return scale[:, None] * offsets, report


def _rings(faces: np.ndarray, seeds: np.ndarray, reach: int, count: int) -> list[np.ndarray]:
    """The seed vertices, their neighbours, the neighbours of those ..., each vertex once."""
    seen = np.zeros(count, bool)
    seen[seeds] = True
    rings = [seeds]
    for _ in range(reach):
        touched = faces[seen[faces].any(axis=1)]
        new = np.setdiff1d(np.unique(touched), np.flatnonzero(seen))
        rings.append(new)
        seen[new] = True
    return rings

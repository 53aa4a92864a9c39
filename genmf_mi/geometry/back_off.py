"""Take relief back where it makes the surface cut through itself."""

from __future__ import annotations

from typing import Any

import numpy as np

from genmf_mi.geometry.parameterization import FindSelfIntersections

HALVINGS = 6
"""Rounds in which relief is halved about a self-intersection; after these it is taken back altogether, ever farther
around."""
WIDENINGS = 6
"""Rounds with a doubled reach before all relief is given up."""
REACH = 3
"""Rings of neighbours that give way together with a face that cuts through another."""


def back_off(
    vertices: np.ndarray, faces: np.ndarray, offsets: np.ndarray, find_self_intersections: FindSelfIntersections
) -> tuple[np.ndarray, dict[str, Any]]:
    """Scale ``offsets [V,3]`` down around faces that cut through others in ``vertices + offsets``, until these are no
    more than ``vertices`` alone have.

    Relief is halved at such a spot first, then taken back, and then taken back ever farther around it: the reach
    doubles with every round. The worst case is the initial surface; the report says how much was taken back.

    Returns:
        The offsets, and a report: ``self_intersections_before`` (faces, of the initial surface), ``untangled`` (faces,
        of the surface as given), ``vertices_held_back`` and ``relief_backed_off``, their share of all vertices.
    """
    before = len(find_self_intersections(vertices, faces))
    scale, reach, first, attempt = np.ones(len(vertices)), REACH, 0, 0
    while True:
        intersecting = find_self_intersections(vertices + scale[:, None] * offsets, faces)
        first = first if attempt else len(intersecting)
        if len(intersecting) <= before:
            break
        if attempt == HALVINGS + WIDENINGS:
            scale[:] = 0
            break
        halve = attempt < HALVINGS
        # The rings next to the spot give way most, so that no new edge appears at its rim
        for number, ring in enumerate(_rings(faces, np.unique(faces[intersecting]), reach, len(vertices))):
            share = number / (reach + 1)
            scale[ring] *= 0.5 + 0.5 * share if halve else max(0.0, 2 * share - 1)
        attempt += 1
        reach = reach if halve else 2 * reach
    held_back = int((scale < 1).sum())
    return scale[:, None] * offsets, {
        "self_intersections_before": before,
        "untangled": first,
        "vertices_held_back": held_back,
        "relief_backed_off": held_back / len(vertices),
    }


def _rings(faces: np.ndarray, seeds: np.ndarray, reach: int, count: int) -> list[np.ndarray]:
    """The seed vertices, their neighbours, the neighbours of those ..., each vertex once."""
    seen = np.zeros(count, bool)
    seen[seeds] = True
    rings = [seeds]
    for _ in range(reach):
        touched = faces[seen[faces].any(axis=1)]
        ring = np.setdiff1d(np.unique(touched), np.flatnonzero(seen))
        if len(ring) == 0:
            break
        rings.append(ring)
        seen[ring] = True
    return rings

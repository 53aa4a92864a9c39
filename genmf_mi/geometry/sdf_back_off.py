"""Take changes of a field back where the surface extracted from it cuts through itself."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.spatial import KDTree

from genmf_mi.geometry.parameterization import FindSelfIntersections, RefinedSurface

REACH_CELLS, GROWTH = 2.0, 1.5
"""How far around a self-intersection changes are taken back, in cells, and by how much farther each time that was not
enough there."""
PATIENCE = 4
"""Attempts after which every spot counts as one that has failed before, so that the procedure ends."""

Kept = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Shares 0..1 of the changes of Φ, of the deformation and of the weights that are kept."""


def back_off_fields(
    extract: Callable[[Kept], RefinedSurface],
    places: tuple[np.ndarray, np.ndarray, np.ndarray],
    to_grid: Callable[[np.ndarray], np.ndarray],
    cell: float,
    initial: tuple[np.ndarray, np.ndarray],
    find_self_intersections: FindSelfIntersections,
) -> RefinedSurface:
    """Extract the surface with ever less change of the fields about its self-intersections, until no more of these are
    left than the initial surface has.

    At a new spot the deformation and the weights are taken back, as these make faces cut through each other within a
    cell; where that was not enough, half of the change of Φ, then all of it, and ever farther around the spot.

    Args:
        extract: the surface for given shares of the changes.
        places: where Φ, deformation and weights are known, three ``[N,3]`` in grid units.
        to_grid: from the frame of the surfaces to grid units.
        cell: side of a cell in grid units.
        initial: vertices ``[V,3]`` and faces ``[F,3]`` of the initial surface.
    """

    def spots_of(vertices: np.ndarray, faces: np.ndarray, found: np.ndarray) -> np.ndarray:
        return to_grid(vertices[np.unique(faces[found])])

    found_before = find_self_intersections(*initial)
    tolerated = KDTree(spots_of(*initial, found_before))
    phi, deformation, weights = (np.ones(len(x)) for x in places)
    kept: Kept = phi, deformation, weights
    failed: list[KDTree] = []
    near, first = REACH_CELLS * cell, 0
    for attempt in itertools.count():
        surface = extract(kept)
        found = find_self_intersections(surface.vertices, surface.faces)
        first = first if attempt else len(found)
        if len(found) <= len(found_before) or not any(share.any() for share in kept):
            break
        spots = spots_of(surface.vertices, surface.faces, found)
        new = tolerated.query(spots)[0] > near
        spots = spots[new] if new.any() else spots
        failures = np.full(len(spots), attempt // PATIENCE)
        for earlier in failed:
            failures += earlier.query(spots)[0] < near
        failed.append(KDTree(spots))
        _take_back(kept, places, spots, failures, near)
    held_back = np.minimum(*kept[:2]) < 1
    report = {
        "self_intersections_before": len(found_before),
        "untangled": first,
        "samples_held_back": int(held_back.sum()),
        "relief_backed_off": float(held_back.mean()),
    }
    return replace(surface, report=report)


def _take_back(
    kept: Kept, places: tuple[np.ndarray, ...], spots: np.ndarray, failures: np.ndarray, near: float
) -> None:
    """Lower ``kept`` about each of ``spots [S,3]`` by its number of ``failures [S]``."""
    for count in np.unique(failures):
        tree, reach = KDTree(spots[failures == count]), near * GROWTH ** max(count - 1, 0)
        for share, at, taken in zip(kept, places, (min(count / 2, 1), 1, 1), strict=True):
            distance = tree.query(at, distance_upper_bound=reach)[0] / reach
            share *= 1 - taken * np.clip(2 - 2 * distance, 0, 1)

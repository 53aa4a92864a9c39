"""A mesh of a body with a bounded number of nodes, for what is solved many times."""

from __future__ import annotations

import numpy as np

from genmf_mi.core.frame import HALF_EXTENT
from genmf_mi.stress.fem.tet_mesh import TetMesh, largest_component
from genmf_mi.stress.fem.tetrahedra import isosurface_stuffing

FINEST, MOST_NODES = 0.025 * 2 * HALF_EXTENT, 15_000
"""Edge of the mesh in normalised units, 2.5 mm of 100; and nodes from which on it is longer, so that a solve takes
about a second."""
MIN_VOLUME_SHARE = 0.9
"""Share of the body's volume that a mesh must hold: thin walls fall through a coarse mesh, and what is left of the body
is no model of it."""


def body_mesh(phi: np.ndarray, nodes: int = MOST_NODES, finest: float | None = None) -> tuple[TetMesh, float]:
    """The largest piece of the body Φ < 0, ``phi [n,n,n]``, in normalised units, and the edge of its mesh.

    nodes, finest: see :func:`mesh_edge`.

    Raises:
        SolidError: the mesh holds nothing of the body.
    """
    edge = mesh_edge(phi, nodes, finest)
    mesh, _ = largest_component(isosurface_stuffing(phi, edge))
    return mesh, edge


def mesh_edge(phi: np.ndarray, nodes: int = MOST_NODES, finest: float | None = None) -> float:
    """Edge in normalised units of a mesh of the body with about so many ``nodes``, at least ``finest``, which is
    :data:`FINEST` if None."""
    # The lattice has two nodes per cube of its edge
    return max(FINEST if finest is None else finest, (2 * volume(phi) / nodes) ** (1 / 3))


def volume(phi: np.ndarray) -> float:
    """Of the body Φ < 0, ``phi [n,n,n]``, in cubic normalised units."""
    cell = 2.0 / (phi.shape[0] - 1)
    return float(np.clip(0.5 - phi / cell, 0, 1).sum()) * cell**3

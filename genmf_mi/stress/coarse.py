"""The stress field on a coarse mesh: what the compact network is told of the part as a whole.

A network with four poolings that sees some hundred shapes does not learn elasticity. A mesh of :data:`EDGE_MM` does not
see relief, but it has the thermal load, the clamp and the bending of the part right to about a tenth, in a second or
two. The network adds what is finer. When a shape is being refined, the field of the shape before is held on to: what
relief changes is then for the network to tell, and has derivatives.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from genmf_mi.errors import SolidError
from genmf_mi.frame import Frame
from genmf_mi.stress import fem
from genmf_mi.stress.grid import to_grid

EDGE_MM = 4.0
"""Side of the lattice that the tetrahedra come from, on a part of 100 mm."""
BEYOND_CELLS = 8.0
"""How far outside of the body there is a value, that of the nearest point inside: relief may grow that far."""


def coarse_stress(phi: np.ndarray, settings: fem.Settings, edge_mm: float = EDGE_MM) -> np.ndarray:
    """Von Mises in MPa, float32 ``[n,n,n]``, of the body Φ < 0 on a coarse mesh; smooth across the surface.

    All zero if the mesh is too coarse to hold anything of the body.

    Args:
        phi: ``[n,n,n]`` on the grid [-1, 1]³.
        settings: how the part is simulated; their ``edge_mm`` is not used.
        edge_mm: for a longest side of 100 mm, in proportion for others.

    Raises:
        SolveError: a solve did not converge.
    """
    frame = Frame((0.0, 0.0, 0.0), 1.0, settings.size_mm)
    coarser = replace(settings, edge_mm=edge_mm * settings.size_mm / 100.0)
    try:
        simulation = fem.simulate_distance(np.asarray(phi, dtype=np.float32), frame, coarser, fem.Laps())
    except SolidError:
        return np.zeros(phi.shape, dtype=np.float32)
    reach = BEYOND_CELLS * 2.0 / (phi.shape[0] - 1)
    return to_grid(simulation.mesh, simulation.field.von_mises_nodes, phi - reach)[0]

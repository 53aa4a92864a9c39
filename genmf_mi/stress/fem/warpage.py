"""Warpage: how far the base of a printed part is from flat once it is taken off the bed.

A linear elastic body that cools on its bed as a whole is as flat as before when it is released. What warps a part is
that it is built in layers: each is laid down hot on a body that has contracted already, and contracts in its turn. Here
the part grows in a few thick layers. Each appears free of stress, contracts by α (T₀ − T_amb) and loads what is
below it; cells of layers that are not there yet are almost without stiffness (the *quiet elements* of the additive
manufacturing literature). At the end the clamp is removed and the residual stress bends the part.

Order of magnitude only: no creep on a warm bed, no infill, and a bed that never lets go before the print ends. See the
section on warpage in docs/stress.md for what was compared with it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from genmf_mi.core.errors import SolidError
from genmf_mi.core.frame import HALF_EXTENT, Frame
from genmf_mi.core.progress import Progress
from genmf_mi.stress.fem import elasticity, materials
from genmf_mi.stress.fem.assembly import P1
from genmf_mi.stress.fem.body_mesh import MIN_VOLUME_SHARE, body_mesh, volume
from genmf_mi.stress.fem.settings import Settings
from genmf_mi.stress.fem.tet_mesh import TetMesh

LAYERS = (3, 12)
"""Fewest and most layers that the part grows in. A layer must not be thinner than a cell, or the result depends on the
mesh; ten give 5 % less than sixteen, five a third less than ten."""
QUIET = 1e-3
"""Stiffness of what is not printed yet, relative to what is; it also holds up overhangs."""
RELEASED = 1e-7
"""Stiffness of the springs that keep the released part from floating away, relative to E over its height squared."""
FINEST = 0.01 * 2 * HALF_EXTENT
"""Least edge of the mesh in normalised units, 1 mm of 100: thin parts have few cells and need small ones."""
BASE = 0.02
"""Height of what counts as the base, relative to that of the part: the part may stand on rounded feet."""


@dataclass(frozen=True)
class Warpage:
    """The base of a part after its release from the bed.

    flatness_mm: distance of two parallel planes that hold the base between them.
    corners_mm: by how much the outermost points of the base towards −x−y, −x+y, +x−y and +x+y of the bed are above the
    lowest point of the base, once the part is turned so that the base is level on average.
    layers: that the part was built in.
    """

    flatness_mm: float
    corners_mm: tuple[float, float, float, float]
    layers: int


def warpage(phi: np.ndarray, frame: Frame, settings: Settings, progress: Progress | None = None) -> Warpage | None:
    """Of the body Φ < 0, on a mesh of its own of about 15 000 nodes; None if the body is too thin for that.

    Args:
        phi: ``[n,n,n]``, normalised frame. frame: of the part, its size and the way it is printed.
        settings: material and protocol; its edge and size are not used.

    Raises:
        SolveError: a solve did not converge.
    """
    try:
        mesh, edge = body_mesh(phi, finest=FINEST)
    except SolidError:
        return None
    if mesh.volumes.sum() < MIN_VOLUME_SHARE * volume(phi):
        return None
    printed = mesh.with_points(frame.to_print(mesh.points))
    height = float(np.ptp(printed.points[:, 2]))
    layers = int(np.clip(height / (edge * frame.mm_per_unit), *LAYERS))
    motion = released(printed, materials.material(settings.material), settings, layers, progress)
    return measured(printed.points, motion, layers)


def released(
    mesh: TetMesh, material: materials.Material, settings: Settings, layers: int, progress: Progress | None = None
) -> np.ndarray:
    """Displacement in mm ``[N,3]`` of a part that was built in ``layers`` and taken off the bed.

    Args:
        mesh: in millimetres with z up.
    """
    progress, elements = progress or Progress(), P1(mesh)
    height = mesh.points[:, 2]
    base, extent = height.min(), float(np.ptp(height))
    level = (height[elements.cells].mean(axis=1) - base) / extent
    layer = np.minimum((level * layers).astype(int), layers - 1)
    modulus, nodal_volume = material.youngs_modulus_mpa, elements.nodal_volume()
    clamp = elasticity.soft_clamp(height, nodal_volume, modulus, settings.protocol.clamp_fraction)
    contraction = settings.protocol.ambient_end_celsius - material.stress_free_celsius

    motion, stress = np.zeros_like(mesh.points), np.zeros((len(elements.cells), 3, 3))
    for last in range(layers):
        progress.advance(last, layers + 1)
        there = layer <= last
        equilibrium = elasticity.Equilibrium(elements, material, clamp, stiffness=np.where(there, 1.0, QUIET))
        rise = np.where(layer == last, contraction, 0.0)
        step, _ = equilibrium.solve(elements.divergence_load(material.thermal_modulus * rise))
        stress[there] += elasticity.hooke(elements.strain(step), material, rise)[there]
        motion += step
    progress.advance(layers, layers + 1)
    afloat = RELEASED * modulus / extent**2 * nodal_volume
    step, _ = elasticity.Equilibrium(elements, material, afloat).solve(-elements.stress_load(stress))
    return motion + step


def measured(points: np.ndarray, motion: np.ndarray, layers: int) -> Warpage:
    """The warpage of a base: ``points [N,3]`` in mm with z up, and their ``motion [N,3]``."""
    height = points[:, 2] - points[:, 2].min()
    base = height <= BASE * height.max()
    where, lift = points[base, :2] - points[base, :2].mean(axis=0), motion[base, 2]
    plane = np.column_stack([np.ones(len(where)), where])
    lift = lift - plane @ np.linalg.lstsq(plane, lift, rcond=None)[0]
    lift -= lift.min()
    a, b, c, d = (float(lift[np.argmax(where @ [x, y])]) for x in (-1, 1) for y in (-1, 1))
    return Warpage(float(lift.max()), (a, b, c, d), layers)

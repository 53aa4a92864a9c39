"""From a surface to a stress field: Φ, tetrahedra, heat, elasticity, von Mises."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from genmf_mi.core.errors import SolidError
from genmf_mi.core.frame import Frame
from genmf_mi.core.progress import Progress
from genmf_mi.core.timer import Timer
from genmf_mi.sdf import distance
from genmf_mi.stress.fem import materials
from genmf_mi.stress.fem.grid import to_grid
from genmf_mi.stress.fem.problem import Field, Problem, solve
from genmf_mi.stress.fem.settings import Settings
from genmf_mi.stress.fem.stages import stage
from genmf_mi.stress.fem.tet_mesh import TetMesh, largest_component
from genmf_mi.stress.fem.tetrahedra import isosurface_stuffing

__all__ = [
    "Field",
    "Problem",
    "Settings",
    "Simulation",
    "frame_of",
    "simulate",
    "simulate_distance",
    "simulate_tetrahedra",
    "solve",
]


@dataclass(frozen=True)
class Simulation:
    """A field together with the shape that it belongs to.

    phi: Φ on the grid, float32 ``[n,n,n]``, normalised frame. mesh: the same cells in the normalised frame.
    dropped: volumes in mm³ of the components that were left out, as they do not hang together with the largest.
    thin_fraction: of the surface, under which the body is too thin for the grid (:func:`distance.thin_fraction`).
    seconds: wall time of each stage.
    """

    settings: Settings
    frame: Frame
    phi: np.ndarray
    mesh: TetMesh
    field: Field
    dropped: list[float]
    thin_fraction: float
    seconds: dict[str, float]

    def on_grid(self) -> tuple[np.ndarray, int]:
        """Von Mises in MPa on the grid, see :func:`genmf_mi.stress.fem.grid.to_grid`."""
        return to_grid(self.mesh, self.field.von_mises_nodes, self.phi)


def simulate(
    vertices: np.ndarray, faces: np.ndarray, settings: Settings | None = None, *, progress: Progress | None = None
) -> Simulation:
    """Simulate the solid that a surface encloses.

    Args:
        vertices: ``[V,3]``, file frame, y up.
        faces: ``[F,3]``.

    Raises:
        SolidError: nothing enclosed, not numbers, or too thin for the tetrahedra.
        SolveError: a solve did not converge.
    """
    settings, progress, timer = settings or Settings(), progress or Progress(), Timer()
    with stage("distance", timer, progress):
        vertices = np.asarray(vertices, dtype=np.float64)
        frame = frame_of(vertices, settings.size_mm)
        normalised = frame.normalise(vertices)
        phi = distance.signed_distance(normalised, faces, settings.grid)
        thin_fraction = distance.thin_fraction(normalised, faces, phi)
    return simulate_distance(phi, frame, settings, thin_fraction=thin_fraction, timer=timer, progress=progress)


def simulate_distance(
    phi: np.ndarray,
    frame: Frame,
    settings: Settings,
    *,
    thin_fraction: float = 0.0,
    timer: Timer | None = None,
    progress: Progress | None = None,
) -> Simulation:
    """Simulate the body Φ < 0.

    Args:
        phi: ``[n,n,n]``, normalised frame.
        frame: says how large the body is; the size in ``settings`` is not used.
        thin_fraction: noted in the result, see :class:`Simulation`.
        timer: takes the laps; their seconds so far are in the result too.

    Raises:
        SolidError, SolveError: as :func:`simulate`.
    """
    timer, progress = timer or Timer(), progress or Progress()
    with stage("tetrahedra", timer, progress):
        mesh, dropped = largest_component(isosurface_stuffing(phi, settings.edge_mm / frame.mm_per_unit))
    field = _solve(mesh, frame, settings, timer, progress)
    dropped = [volume * frame.mm_per_unit**3 for volume in dropped]
    return Simulation(settings, frame, phi, mesh, field, dropped, thin_fraction, dict(timer.seconds))


def simulate_tetrahedra(
    mesh: TetMesh, settings: Settings | None = None, *, progress: Progress | None = None
) -> Simulation:
    """Simulate a given volume mesh (file frame, y up), scaled to ``size_mm``. Raises as :func:`simulate`."""
    settings, progress, timer = settings or Settings(), progress or Progress(), Timer()
    with stage("distance", timer, progress):
        mesh, dropped = largest_component(mesh)
        frame = frame_of(mesh.points, settings.size_mm)
        mesh = mesh.with_points(frame.normalise(mesh.points))
        phi = distance.signed_distance(mesh.points, mesh.boundary(), settings.grid)
    field = _solve(mesh, frame, settings, timer, progress)
    dropped = [volume * (frame.scale * frame.mm_per_unit) ** 3 for volume in dropped]
    return Simulation(settings, frame, phi, mesh, field, dropped, 0.0, dict(timer.seconds))


def frame_of(vertices: np.ndarray, size_mm: float) -> Frame:
    """The frame of a surface. Raises :class:`SolidError` where it has no extent or is not made of numbers."""
    if len(vertices) == 0:
        raise SolidError("the mesh has no vertices; export it again.")
    if not np.isfinite(vertices).all():
        raise SolidError("the mesh has vertices that are not numbers; export it again.")
    if not np.ptp(vertices, axis=0).max() > 0:
        raise SolidError("all vertices of the mesh are in one place; export it again.")
    return Frame.of(vertices, size_mm)


def _solve(mesh: TetMesh, frame: Frame, settings: Settings, timer: Timer, progress: Progress) -> Field:
    """The field on ``mesh`` of the normalised frame, on the print bed in millimetres."""
    printed = mesh.with_points(frame.to_print(mesh.points))
    problem = Problem(printed, materials.material(settings.material), settings.protocol)
    return problem.solve(timer, progress)

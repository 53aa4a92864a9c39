"""From a surface to a stress field: Φ, tetrahedra, heat, elasticity, von Mises."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from math import isfinite

import numpy as np

from genmf_mi.core.errors import ConfigError, SolidError
from genmf_mi.core.frame import Frame
from genmf_mi.sdf import distance
from genmf_mi.stress.fem import elasticity, heat, tetrahedra
from genmf_mi.stress.fem.assembly import P1
from genmf_mi.stress.fem.grid import to_grid
from genmf_mi.stress.fem.materials import Material, material
from genmf_mi.stress.fem.protocol import Protocol
from genmf_mi.stress.fem.tetrahedra import TetMesh

Progress = Callable[[str, float], None]
"""Called with the name of the stage and the fraction of the whole that is done."""


@dataclass(frozen=True)
class Settings:
    """How a shape is simulated.

    Raises:
        ConfigError: a length that is not positive, or a grid too small to hold a shape.
    """

    size_mm: float = 100.0
    """Longest side of the part."""
    edge_mm: float = 1.6
    """Side of the lattice that the tetrahedra come from. 1.6 for training data, 1.2 or less to judge relief."""
    grid: int = 129
    """Samples per axis of Φ and of the field."""
    material: str = "pla"
    protocol: Protocol = field(default_factory=Protocol)

    def __post_init__(self) -> None:
        for name in ("size_mm", "edge_mm"):
            if not (isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise ConfigError(f"{name} must be positive, not {getattr(self, name)}.")
        if self.grid < 17:
            raise ConfigError(f"grid must be at least 17 samples per axis, not {self.grid}.")
        material(self.material)


@dataclass(frozen=True)
class Field:
    """The solution on one mesh, in millimetres, °C and MPa; z is up and the base at z = 0.

    temperature: ``[N]``. displacement: ``[N,3]``. stress: ``[T,3,3]``, constant in each cell.
    von_mises: ``[T]``. von_mises_nodes: ``[N]``, the volume-weighted average of the cells at the node (of the value,
    not of the tensor, which would hide a bending stress that changes sign).
    """

    elements: P1
    temperature: np.ndarray
    displacement: np.ndarray
    stress: np.ndarray
    von_mises: np.ndarray
    von_mises_nodes: np.ndarray
    iterations: int
    seconds: dict[str, float]

    @property
    def mesh(self) -> TetMesh:
        return self.elements.mesh


@dataclass(frozen=True)
class Simulation:
    """A field together with the shape that it belongs to.

    phi: Φ on the grid, float32 ``[n,n,n]``, normalised frame. mesh: the same cells in the normalised frame.
    dropped: volumes in mm³ of bodies that are not held by the largest. lost: see :func:`distance.lost_fraction`.
    """

    settings: Settings
    frame: Frame
    phi: np.ndarray
    mesh: TetMesh
    field: Field
    dropped: list[float]
    lost: float
    seconds: dict[str, float]

    def on_grid(self) -> tuple[np.ndarray, int]:
        """Von Mises in MPa on the grid, see :func:`genmf_mi.stress.fem.grid.to_grid`."""
        return to_grid(self.mesh, self.field.von_mises_nodes, self.phi)


class Laps:
    """Seconds of this process spent between calls, by name; reports progress on the way."""

    def __init__(self, progress: Progress | None = None) -> None:
        self.seconds: dict[str, float] = {}
        self._last = time.process_time()
        self._progress = progress or (lambda stage, done: None)

    def __call__(self, name: str, done: float) -> None:
        now = time.process_time()
        self.seconds[name] = round(self.seconds.get(name, 0.0) + now - self._last, 3)
        self._last = now
        self._progress(name, done)

    def tell(self, stage: str, done: float) -> None:
        self._progress(stage, done)


class Problem:
    """One body and what happens to it, with all that its adjoint needs (:mod:`genmf_mi.stress.fem.sensitivity`).

    mesh: in millimetres with z up. Once solved, it has ``cooling`` and ``equilibrium``, the two systems, and
    ``excess [K+1,N]``, T − T₀ after each step of time.
    """

    def __init__(self, mesh: TetMesh, stuff: Material, protocol: Protocol) -> None:
        self.elements, self.material, self.protocol = P1(mesh), stuff, protocol
        start = stuff.stress_free_celsius
        times = protocol.step_s * np.arange(1, protocol.steps + 1)
        self.ambient = np.array([protocol.ambient(time, start) - start for time in times])

    def solve(self, laps: Laps | None = None) -> Field:
        """The field. Raises :class:`SolveError` if a solve did not converge."""
        laps = laps or Laps()
        elements, stuff, protocol = self.elements, self.material, self.protocol
        height, start = elements.mesh.points[:, 2], stuff.stress_free_celsius
        self.cooling = heat.Cooling(elements, stuff, protocol.heat_transfer_coefficient_w_mm2k, protocol.step_s)
        tick = lambda step, steps: laps.tell("heat", 0.3 + 0.2 * step / steps)  # noqa: E731
        self.excess = self.cooling.run(self.ambient, tick)
        excess = self.excess[-1]
        laps("heat", 0.5)
        spring = elasticity.soft_clamp(
            height, elements.nodal_volume(), stuff.youngs_modulus_mpa, protocol.clamp_fraction
        )
        self.equilibrium = elasticity.Equilibrium(elements, stuff, spring)
        moved, iterations = self.equilibrium.solve(elasticity.thermal_load(elements, stuff, excess))
        laps("elasticity", 0.9)
        tensor = elasticity.stress(elements, stuff, moved, excess)
        equivalent = elasticity.von_mises(tensor)
        at_nodes = elements.to_nodes(equivalent)
        laps("stress", 0.95)
        return Field(elements, start + excess, moved, tensor, equivalent, at_nodes, iterations, laps.seconds)


def solve(mesh: TetMesh, stuff: Material, protocol: Protocol, laps: Laps | None = None) -> Field:
    """The field on ``mesh``, given in millimetres with z up.

    Raises:
        SolveError: a solve did not converge.
    """
    return Problem(mesh, stuff, protocol).solve(laps)


def simulate(
    vertices: np.ndarray, faces: np.ndarray, settings: Settings | None = None, progress: Progress | None = None
) -> Simulation:
    """Simulate the solid that a surface encloses.

    Args:
        vertices: ``[V,3]``, file frame, y up.
        faces: ``[F,3]``.

    Raises:
        SolidError: nothing enclosed, not numbers, or too thin for the tetrahedra.
        SolveError: a solve did not converge.
    """
    settings = settings or Settings()
    laps = Laps(progress)
    vertices = np.asarray(vertices, dtype=np.float64)
    frame = frame_of(vertices, settings.size_mm)
    inside = frame.normalise(vertices)
    phi = distance.signed_distance(inside, faces, settings.grid)
    lost = distance.lost_fraction(inside, faces, phi)
    laps("distance", 0.15)
    return simulate_distance(phi, frame, settings, laps, lost)


def simulate_distance(phi: np.ndarray, frame: Frame, settings: Settings, laps: Laps, lost: float = 0.0) -> Simulation:
    """Simulate the body Φ < 0; ``frame`` says how large it is. Raises as :func:`simulate`."""
    mesh, dropped = tetrahedra.largest_body(tetrahedra.isosurface_stuffing(phi, settings.edge_mm / frame.mm_per_unit))
    laps("tetrahedra", 0.3)
    return _finish(mesh, [volume * frame.mm_per_unit**3 for volume in dropped], phi, frame, settings, laps, lost)


def simulate_tetrahedra(
    mesh: TetMesh, settings: Settings | None = None, progress: Progress | None = None
) -> Simulation:
    """Simulate a given volume mesh (file frame, y up), scaled to ``size_mm``. Raises as :func:`simulate`."""
    settings = settings or Settings()
    laps = Laps(progress)
    mesh, dropped = tetrahedra.largest_body(mesh)
    frame = frame_of(mesh.points, settings.size_mm)
    mm = frame.scale * frame.mm_per_unit
    mesh = mesh.moved(frame.normalise(mesh.points))
    phi = distance.signed_distance(mesh.points, mesh.boundary(), settings.grid)
    laps("distance", 0.3)
    return _finish(mesh, [volume * mm**3 for volume in dropped], phi, frame, settings, laps, 0.0)


def frame_of(vertices: np.ndarray, size_mm: float) -> Frame:
    """The frame of a surface. Raises :class:`SolidError` where it has no extent or is not made of numbers."""
    if len(vertices) == 0:
        raise SolidError("the mesh has no vertices; export it again.")
    if not np.isfinite(vertices).all():
        raise SolidError("the mesh has vertices that are not numbers; export it again.")
    if not np.ptp(vertices, axis=0).max() > 0:
        raise SolidError("all vertices of the mesh are in one place; export it again.")
    return Frame.of(vertices, size_mm)


def _finish(mesh, dropped, phi, frame, settings, laps, lost) -> Simulation:
    solution = solve(mesh.moved(frame.to_print(mesh.points)), material(settings.material), settings.protocol, laps)
    return Simulation(settings, frame, phi, mesh, solution, dropped, lost, laps.seconds)

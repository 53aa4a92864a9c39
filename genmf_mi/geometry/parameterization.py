"""What the refinement loop asks of the geometry that it moves, whichever that is.

:class:`genmf_mi.geometry.mesh.MeshParameterization` moves the vertices of a mesh, :class:`genmf_mi.geometry.sdf.SdfParameterization` the
field that a mesh is extracted from.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

if TYPE_CHECKING:
    from torch import Tensor

Crossings = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""From vertices and faces to the indices of the faces that cut through others."""


class Geometry(NamedTuple):
    """The geometry as it stands, differentiable with respect to the latent.

    vertices: ``[V,3]``, normalised frame. faces: ``[F,3]``, or None if they never change.
    shape: what the stress is predicted from: the vertices, or Φ.
    terms: losses of the geometry itself, unweighted, by the names of :class:`genmf_mi.core.config.Weights`.
    """

    vertices: Tensor
    faces: Tensor | None
    shape: Tensor
    terms: dict[str, Tensor]


@dataclass(frozen=True)
class RefinedSurface:
    """A refined surface and where each of its points came from.

    vertices: ``float64 [V,3]``, normalised frame. faces: ``int64 [F,3]``.
    foot, normals: ``[V,3]``, for each vertex its point on the initial surface and the normal there.
    report: what had to be mended.
    """

    vertices: np.ndarray
    faces: np.ndarray
    foot: np.ndarray
    normals: np.ndarray
    report: dict = field(default_factory=dict)

    @property
    def offsets(self) -> np.ndarray:
        """How far each vertex is from the initial surface, ``[V,3]``."""
        return self.vertices - self.foot


class Parameterization(Protocol):
    """What can be refined, with

    latent: what the optimiser moves, a leaf.
    blocks: parts of its first axis, each of which has a step size of its own; the first moves the surface as a whole.
    initial: ``shape`` before anything has moved.
    """

    latent: Tensor
    blocks: tuple[slice, ...]
    initial: Tensor

    def rates(self, progress: float) -> tuple[float, ...]:
        """Share of the learning rate of each block, ``progress`` being 0 at first and 1 in the end."""

    def moved(self) -> Geometry:
        """The geometry as the latent has it."""

    def start_from(self, heights: np.ndarray) -> None:
        """Raise the initial surface by ``heights [V]`` along its normals, as far as there is room."""

    def distance(self, samples: int) -> Callable[[Tensor], Tensor]:
        """From ``shape`` to Φ ``[1,n,n,n]`` on the grid of the stress network."""

    def reached(self) -> np.ndarray:
        """What :meth:`surface` and :meth:`finished` need to know of where the latent is now."""

    def displaced(self, heights: np.ndarray) -> np.ndarray:
        """As :meth:`reached`, for the initial surface raised by ``heights [V]`` and nothing else."""

    def surface(self, reached: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Vertices ``float64 [V,3]`` and faces ``int64 [F,3]``."""

    def finished(self, reached: np.ndarray, crossings: Crossings) -> RefinedSurface:
        """The same, with relief taken back where the surface would cut through itself."""

"""What the refinement loop asks of the geometry that it moves, whichever that is.

:class:`genmf_mi.geometry.mesh.MeshParameterization` moves the vertices of a mesh,
:class:`genmf_mi.geometry.sdf.SdfParameterization` the signed distance that a mesh is extracted from.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

import numpy as np
from torch import Tensor

FindSelfIntersections = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""From vertices ``[V,3]`` and faces ``[F,3]`` to the indices of the faces that cut through others."""


class Geometry(NamedTuple):
    """The geometry as the parameters have it, differentiable with respect to them.

    vertices: ``[V,3]``, normalised frame. faces: ``[F,3]``, or None if they never change.
    shape: what the stress is predicted from: the vertices ``[V,3]``, or Φ ``[m,m,m]``.
    terms: losses of the geometry itself, unweighted, by the names of :class:`genmf_mi.core.config.Weights`.
    """

    vertices: Tensor
    faces: Tensor | None
    shape: Tensor
    terms: dict[str, Tensor]


@dataclass(frozen=True)
class RefinedSurface:
    """A refined surface and the points of the initial surface that its vertices came from.

    vertices: ``float64 [V,3]``, normalised frame. faces: ``int64 [F,3]``.
    foot, normals: ``[V,3]``, for each vertex its point on the initial surface and the unit normal there.
    report: what had to be corrected.
    """

    vertices: np.ndarray
    faces: np.ndarray
    foot: np.ndarray
    normals: np.ndarray
    report: dict[str, Any] = field(default_factory=dict)

    @property
    def offsets(self) -> np.ndarray:
        """Displacement of each vertex from the initial surface, ``[V,3]``."""
        return self.vertices - self.foot


class Parameterization(Protocol):
    """A surface as a function of parameters that an optimiser moves."""

    @property
    def parameters(self) -> tuple[Tensor, ...]:
        """The leaf tensors; the first one moves the surface as a whole."""
        ...

    @property
    def initial_shape(self) -> Tensor:
        """:attr:`Geometry.shape` of the initial surface."""
        ...

    def learning_rates(self, progress: float) -> tuple[float, ...]:
        """Factor on the learning rate of each parameter; ``progress`` runs from 0 to 1."""
        ...

    def geometry(self) -> Geometry:
        """The geometry of the current parameters."""
        ...

    def set_heights(self, heights: np.ndarray) -> None:
        """Raise the initial surface by ``heights [V]`` along its normals, as far as the bounds allow; the low-frequency
        component is left out."""
        ...

    def follow(self, points: np.ndarray, reach: float) -> Callable[[Tensor], Tensor]:
        """A differentiable function from :attr:`Geometry.shape` to the motion ``[N,3]`` of ``points [N,3]`` inside the
        initial surface that follow it: at the surface all the way, ever less below, and not at all from the depth
        ``reach`` on."""
        ...

    def distance(self, samples: int) -> Callable[[Tensor], Tensor]:
        """A differentiable function from :attr:`Geometry.shape` to Φ ``[1,n,n,n]`` on a grid of n = ``samples``."""
        ...

    def state(self) -> Any:
        """The current surface, for :meth:`surface` and :meth:`finish`; independent of later changes."""
        ...

    def displaced(self, heights: np.ndarray) -> Any:
        """The :meth:`state` of the initial surface raised by all of ``heights [V]``; the parameters stay."""
        ...

    def surface(self, state: Any) -> tuple[np.ndarray, np.ndarray]:
        """Vertices ``float64 [V,3]`` and faces ``int64 [F,3]`` of a state."""
        ...

    def finish(self, state: Any, find_self_intersections: FindSelfIntersections) -> RefinedSurface:
        """The surface of a state, with relief taken back wherever it would cut through itself."""
        ...

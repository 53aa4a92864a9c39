"""Relief as offsets of the vertices of a mesh: what the optimiser moves, and how it is kept within its bounds.

The parameter u is related to unbounded offsets x of the vertices by (I + λL) x = u with the combinatorial Laplacian L
(Nicolet, Jacobson and Jakob, *Large Steps in Inverse Rendering of Geometry*, 2021): a step on u is a smooth step on the
surface. The offsets are then squashed by tanh into the bounds that each vertex has along and across its normal, so that
the cap holds at every iteration and not only at the end.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from genmf_mi.geometry.back_off import back_off
from genmf_mi.geometry.displacement_bounds import DisplacementBounds
from genmf_mi.geometry.laplacian import ImplicitDiffusion
from genmf_mi.geometry.low_pass import LowPass
from genmf_mi.geometry.mesh_distance import MeshDistance
from genmf_mi.geometry.parameterization import FindSelfIntersections, Geometry, RefinedSurface
from genmf_mi.mesh.nearest import barycentric, closest_points

SATURATION = 0.98
"""Largest share of its bounds that a height is set to: tanh reaches all of them only at infinity."""


class MeshParameterization:
    """Bounded offsets from a fixed mesh; a :class:`genmf_mi.geometry.parameterization.Parameterization`.

    Args:
        vertices: ``[V,3]`` initial vertices, normalised frame. normals: ``[V,3]`` unit. faces: ``[F,3]``.
        bounds: of the displacement, normalised units; a vertex without any is pinned.
        smoothing: λ.
        low_pass: the filter whose low-frequency component is taken out of the heights. Shading sees slopes, so that
            this component shows nothing; and the gradient, which does not see silhouettes move, would thin limbs by it.
    """

    def __init__(
        self,
        vertices: np.ndarray,
        normals: np.ndarray,
        faces: np.ndarray,
        bounds: DisplacementBounds,
        *,
        smoothing: float,
        low_pass: LowPass | None = None,
        device: str = "cpu",
    ) -> None:
        def tensor(x: np.ndarray) -> Tensor:
            return torch.as_tensor(np.ascontiguousarray(x), dtype=torch.float32, device=device)

        self.faces = np.ascontiguousarray(faces, dtype=np.int64)
        self.initial_shape, self._normals = tensor(vertices), tensor(normals)
        self._vertices64, self._normals64 = np.asarray(vertices, np.float64), np.asarray(normals, np.float64)
        self._inward, self._outward, self._tangential = (
            tensor(x)[:, None].clamp_min(1e-9) for x in (bounds.inward, bounds.outward, bounds.tangential)
        )
        self._diffusion, self._low_pass = (
            ImplicitDiffusion.large_steps(faces, len(vertices), smoothing, device),
            low_pass,
        )
        self.parameters = (torch.zeros(len(vertices), 3, device=device, requires_grad=True),)

    def learning_rates(self, progress: float) -> tuple[float, ...]:
        """All of the learning rate, always."""
        return (1.0,)

    def offsets(self) -> Tensor:
        """``[V,3]``, normalised units: inside the cylinder that the bounds of each vertex make."""
        x = self._diffusion(self.parameters[0])
        height = (x * self._normals).sum(dim=1, keepdim=True)
        tangential = x - height * self._normals
        if self._low_pass is not None:
            height = height - self._low_pass(height)
        bound = torch.where(height > 0, self._outward, self._inward)
        reach = (tangential.square().sum(dim=1, keepdim=True) / self._tangential.square() + 1e-12).sqrt()
        return bound * torch.tanh(height / bound) * self._normals + tangential * (torch.tanh(reach) / reach)

    def geometry(self) -> Geometry:
        """The moved vertices; the faces stay."""
        vertices = self.initial_shape + self.offsets()
        return Geometry(vertices, None, vertices, {})

    def set_heights(self, heights: np.ndarray) -> None:
        """Make :meth:`offsets` ``heights [V]`` along the normals, up to :data:`SATURATION` of the bounds."""
        with torch.no_grad():
            wanted = torch.as_tensor(heights, dtype=torch.float32, device=self.initial_shape.device)[:, None]
            bound = torch.where(wanted > 0, self._outward, self._inward)
            x = bound * torch.atanh((wanted / bound).clamp(-SATURATION, SATURATION))
            self.parameters[0].copy_(self._diffusion.inverse(x * self._normals))

    def follow(self, points: np.ndarray, reach: float) -> Callable[[Tensor], Tensor]:
        """Every point follows the vertices around the nearest point of the surface."""
        face, closest, depth = closest_points(points, self._vertices64, self.faces)
        share = np.clip(1 - depth / reach, 0, 1)[:, None] * barycentric(self._vertices64[self.faces[face]], closest)
        weights = torch.as_tensor(share).to(self.initial_shape)
        corners = torch.as_tensor(self.faces[face], device=weights.device)
        return lambda vertices: (weights[..., None] * (vertices - self.initial_shape)[corners]).sum(dim=1)

    def distance(self, samples: int) -> Callable[[Tensor], Tensor]:
        """See :class:`genmf_mi.geometry.mesh_distance.MeshDistance`."""
        return MeshDistance(self.faces, samples, every=1)

    def state(self) -> np.ndarray:
        """:meth:`offsets` as ``float64 [V,3]``."""
        return self.offsets().detach().cpu().numpy().astype(np.float64)

    def displaced(self, heights: np.ndarray) -> np.ndarray:
        """Offsets ``[V,3]`` of ``heights [V]`` along the normals."""
        return heights[:, None] * self._normals64

    def surface(self, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Vertices ``[V,3]`` and faces ``[F,3]``."""
        return self._vertices64 + state, self.faces

    def finish(self, state: np.ndarray, find_self_intersections: FindSelfIntersections) -> RefinedSurface:
        """See :func:`genmf_mi.geometry.back_off.back_off`."""
        offsets, report = back_off(self._vertices64, self.faces, state, find_self_intersections)
        return RefinedSurface(self._vertices64 + offsets, self.faces, self._vertices64, self._normals64, report)

"""Relief on a shape that is Φ on a grid: what the optimiser moves, and how it is kept within its bounds.

Three things move: Φ, the deformation of the grid and the weights of FlexiCubes. Φ = Φ₀ − s·b·tanh(h / b), where Φ₀ is
the field of the generator, s its slope, so that h is a height in normalised units, and b the bound of the displacement
at the closest point of the initial surface. h is a smooth function of the parameter u in the manner of Nicolet et al.
2021: (I + λL) h = u, with L the Laplacian of the grid's own graph, of which only a shell about the surface is kept. The
deformation and the weights add what is smaller than a cell; the steps of the deformation grow from nothing, as in
GenMF.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from genmf_mi.assets.sdf_asset import SdfAsset
from genmf_mi.core.frame import Frame
from genmf_mi.geometry.displacement_bounds import DisplacementBounds
from genmf_mi.geometry.laplacian import ImplicitDiffusion
from genmf_mi.geometry.low_pass import LowPass
from genmf_mi.geometry.mesh import SATURATION
from genmf_mi.geometry.parameterization import FindSelfIntersections, Geometry, RefinedSurface
from genmf_mi.geometry.sdf_back_off import Kept, back_off_fields
from genmf_mi.geometry.sdf_distance import SdfDistance, free_weights, sampled, slope
from genmf_mi.losses import sdf as losses
from genmf_mi.mesh.nearest import Nearest, barycentric, closest_points
from genmf_mi.sdf.flexicubes import WEIGHTS, FlexiCubes
from genmf_mi.sdf.grid import SMALL_COMPONENT_SHARE, without_small_components
from genmf_mi.sdf.shell import shell

RATE, DEFORMATION_RATE, WEIGHTS_RATE = 2.0, 8.0, 8.0
"""Learning rates of Φ, of the deformation (at the end; see :meth:`SdfParameterization.learning_rates`) and of the
weights, whose parameters have no unit, as multiples of that of a mesh."""
DEFORMATION_LIMIT = 0.25
"""Share of a cell that a sample may move along each axis."""


class SdfState(NamedTuple):
    """A surface as the values of the parameters ``[N]``, ``[N,3]``, ``[K,21]``, and whether the low-frequency component
    of the heights is left out."""

    parameters: tuple[Tensor, ...]
    filtered: bool


class SdfParameterization:
    """Φ, deformation and weights about a fixed surface; a
    :class:`genmf_mi.geometry.parameterization.Parameterization`.

    Args:
        asset: its ``surface(training=True)`` is the initial surface. frame: of the part.
        vertices, normals: ``[V,3]`` of that surface, normalised frame; faces: ``[F,3]``.
        bounds: along the normal, normalised units; where there are none, nothing moves.
        smoothing: λ.
        wavelength: normalised units; longer waves are taken out of the heights, see
            :class:`genmf_mi.geometry.mesh.MeshParameterization`.
    """

    def __init__(
        self,
        asset: SdfAsset,
        frame: Frame,
        vertices: np.ndarray,
        faces: np.ndarray,
        normals: np.ndarray,
        bounds: DisplacementBounds,
        *,
        smoothing: float,
        wavelength: float,
        device: str = "cpu",
    ) -> None:
        self.device, self.vertices, self.faces, self.normals, self.bounds = device, vertices, faces, normals, bounds
        self.scale = asset.half * frame.scale
        self.shift = (np.asarray(asset.centre) - np.asarray(frame.centre)) * frame.scale
        self.cell = 2 / asset.resolution
        cap = max(bounds.inward.max(), bounds.outward.max()) / self.scale
        self.shell = shell(asset.phi < 0, asset.deformation, self.to_grid(vertices), faces, cap)
        self._heights_of(asset, smoothing, wavelength)
        self._deformation_of(asset)
        self._weights_of(asset)
        samples, cubes = len(self.shell.samples), len(self.shell.cubes)
        self.parameters = tuple(
            torch.zeros(shape, device=device, requires_grad=True) for shape in (samples, (samples, 3), (cubes, WEIGHTS))
        )

    def _tensor(self, x: np.ndarray) -> Tensor:
        return torch.as_tensor(np.ascontiguousarray(x), dtype=torch.float32, device=self.device)

    def _heights_of(self, asset: SdfAsset, smoothing: float, wavelength: float) -> None:
        """Φ₀, its slope per normalised unit, and the bounds and filters of the heights at the samples of the shell."""
        near, count = self.shell, len(self.shell.samples)
        self.initial_shape = self._tensor(asset.phi)
        self.samples = torch.as_tensor(near.samples, device=self.device)
        self.slope = self._tensor(slope(asset.phi, near.samples, near.distance))[:, None] / self.scale
        self._inward, self._outward = (
            self._tensor(self._at_samples(x))[:, None].clamp_min(1e-9)
            for x in (self.bounds.inward, self.bounds.outward)
        )
        self._diffusion = ImplicitDiffusion.large_steps(near.edges, count, smoothing, self.device)
        self._low_pass = LowPass(near.places * self.scale, near.edges, wavelength, self.device)

    def _deformation_of(self, asset: SdfAsset) -> None:
        """The deformation of the generator, and how much each sample of the shell may add to it along each axis."""
        m, half_cell = len(asset.phi), 1 / asset.resolution
        initial = np.zeros((m, m, m, 3), np.float32) if asset.deformation is None else asset.deformation
        self._initial_deformation = self._tensor(initial).reshape(-1, 3)
        bound = torch.minimum(self._inward, self._outward) / self.scale
        spare = (half_cell - self._initial_deformation[self.samples].abs()).clamp_min(0)
        self._deformation_limit = torch.minimum(spare.clamp_max(2 * DEFORMATION_LIMIT * half_cell), bound)

    def _weights_of(self, asset: SdfAsset) -> None:
        """The weights of the generator in the cubes of the shell, and a factor on what is added to them, from 0 where
        there is no bound to 1 where it is half a cell or more."""
        near = self.shell
        row = np.full(asset.resolution**3, -1, np.int32)
        row[near.cubes] = np.arange(len(near.cubes))
        self._extract = FlexiCubes(asset.spread, torch.as_tensor(row, device=self.device))
        self._initial_weights = self._tensor(free_weights(asset, near.cubes))
        bound = np.minimum(self.bounds.inward, self.bounds.outward)[self.faces[near.cube_face]]
        bound = np.einsum("kc,kc->k", bound, near.cube_weights)
        self._weights_factor = self._tensor(np.clip(2 * bound / (self.cell * self.scale), 0, 1))[:, None]

    def learning_rates(self, progress: float) -> tuple[float, ...]:
        """For Φ and the weights always the same, and for the deformation little but ever more."""
        return RATE, DEFORMATION_RATE * progress, WEIGHTS_RATE

    def heights(self, state: SdfState) -> Tensor:
        """``[N,1]`` by which the surface is raised at the samples of the shell, normalised units, within the bounds."""
        x = self._diffusion(state.parameters[0][:, None])
        if state.filtered:
            x = x - self._low_pass(x)
        bound = torch.where(x > 0, self._outward, self._inward)
        return bound * torch.tanh(x / bound)

    def fields(self, state: SdfState, kept: tuple[Tensor, ...] | None = None) -> tuple[Tensor, Tensor, Tensor]:
        """Φ ``[m,m,m]``, deformation ``[m,m,m,3]`` and weights ``[K,21]`` of the cubes in the shell.

        Args:
            kept: shares of the changes of each to keep, ``[N,1]``, ``[N,1]`` and ``[K,1]``; all of them if None.
        """
        change = -self.slope * self.heights(state)
        deformation = self._deformation_limit * torch.tanh(state.parameters[1])
        weights = self._weights_factor * state.parameters[2]
        if kept is not None:
            change, deformation, weights = kept[0] * change, kept[1] * deformation, kept[2] * weights
        phi = self.initial_shape.reshape(-1).index_add(0, self.samples, change[:, 0])
        deformation = self._initial_deformation.index_add(0, self.samples, deformation)
        shape = self.initial_shape.shape
        return phi.view(shape), deformation.view(*shape, 3), self._initial_weights + weights

    def geometry(self) -> Geometry:
        """The extracted surface, Φ, and the losses of both."""
        phi, deformation, weights = self.fields(SdfState(self.parameters, filtered=True))
        surface = self._extract(phi, deformation, weights)
        terms = {
            "sdf_tv": losses.sdf_tv(phi, self.samples, self.cell),
            "l_dev": losses.l_dev(surface.deviation, self.cell),
            "flexi_weight_reg": losses.flexi_weight_reg(surface.weights),
        }
        shift = torch.as_tensor(self.shift, dtype=torch.float32, device=self.device)
        return Geometry(surface.vertices * self.scale + shift, surface.faces, phi, terms)

    def set_heights(self, heights: np.ndarray) -> None:
        """Make :meth:`heights` the ``heights [V]`` of the closest points, up to :data:`SATURATION` of the bounds and
        without their low-frequency component; deformation and weights stay."""
        with torch.no_grad():
            self.parameters[0].copy_(self._parameter_of(heights))

    def _parameter_of(self, heights: np.ndarray) -> Tensor:
        wanted = self._tensor(self._at_samples(heights))[:, None]
        bound = torch.where(wanted > 0, self._outward, self._inward)
        return self._diffusion.inverse(bound * torch.atanh((wanted / bound).clamp(-SATURATION, SATURATION)))[:, 0]

    def follow(self, points: np.ndarray, reach: float) -> Callable[[Tensor], Tensor]:
        """Every point follows the nearest point of the surface along its normal, by what the field was raised there."""
        face, closest, depth = closest_points(points, self.vertices, self.faces)
        weights = barycentric(self.vertices[self.faces[face]], closest)
        normals = np.einsum("nc,nck->nk", weights, self.normals[self.faces[face]])
        along = self._tensor(np.clip(1 - depth / reach, 0, 1)[:, None] * normals)
        at = self._tensor(self.to_grid(closest))
        return lambda phi: -along * sampled(self._sunk(phi), at)[:, None]

    def _sunk(self, phi: Tensor) -> Tensor:
        """By how much ``phi [m,m,m]`` is above what it was, in normalised units, ``[m,m,m]``."""
        change = (phi - self.initial_shape).reshape(-1)[self.samples] / self.slope[:, 0]
        spread = torch.zeros_like(self.initial_shape).reshape(-1)
        return spread.index_copy(0, self.samples, change).view_as(self.initial_shape)

    def distance(self, samples: int) -> Callable[[Tensor], Tensor]:
        """See :class:`genmf_mi.geometry.sdf_distance.SdfDistance`."""
        surface = self.vertices, self.faces
        return SdfDistance(self._sunk, surface, samples, scale=self.scale, shift=self.shift, device=self.device)

    def state(self) -> SdfState:
        """Copies of the parameters."""
        return SdfState(tuple(p.detach().clone() for p in self.parameters), filtered=True)

    def displaced(self, heights: np.ndarray) -> SdfState:
        """The parameters of ``heights [V]`` with all frequencies, and no change of deformation and weights."""
        rest = (torch.zeros_like(p) for p in self.parameters[1:])
        return SdfState((self._parameter_of(heights), *rest), filtered=False)

    def surface(self, state: SdfState) -> tuple[np.ndarray, np.ndarray]:
        """Vertices ``[V,3]`` and faces ``[F,3]`` within their bounds; self-intersections may be left."""
        surface = self.extract(state)
        return surface.vertices, surface.faces

    def finish(self, state: SdfState, find_self_intersections: FindSelfIntersections) -> RefinedSurface:
        """See :func:`genmf_mi.geometry.sdf_back_off.back_off_fields`."""
        return back_off_fields(
            lambda kept: self.extract(state, kept),
            (self.shell.places, self.shell.places, self.shell.centres),
            self.to_grid,
            self.cell,
            (self.vertices, self.faces),
            find_self_intersections,
        )

    def extract(self, state: SdfState, kept: Kept | None = None) -> RefinedSurface:
        """The surface without small components, every vertex within the bounds of its point on the initial surface,
        which deformation and weights do not keep by themselves.

        Components that were just large enough in the initial surface are not small now.

        Args:
            kept: as for :meth:`fields`, ``[N]``, ``[N]`` and ``[K]``.
        """
        with torch.no_grad():
            phi, *rest = self.fields(state, kept and tuple(self._tensor(x)[:, None] for x in kept))
            solid, _ = without_small_components(phi.cpu().numpy(), SMALL_COMPONENT_SHARE / 3)
            phi = torch.as_tensor(solid, device=self.device)
            extracted = self._extract(phi, *rest)
        faces = extracted.faces.cpu().numpy().astype(np.int64)
        points = extracted.vertices.cpu().numpy().astype(np.float64) * self.scale + self.shift
        face, foot, distance = Nearest(self.vertices, self.faces).find(points)
        corners, weights = self.faces[face], barycentric(self.vertices[self.faces[face]], foot)

        def at_foot(field: np.ndarray) -> np.ndarray:
            return np.einsum("vc,vc...->v...", weights, field[corners])

        normals = at_foot(self.normals)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-20)
        offset = points - foot
        raised = np.einsum("vk,vk->v", offset, normals) > 0
        bound = np.where(raised, at_foot(self.bounds.outward), at_foot(self.bounds.inward))
        offset *= np.minimum(1, bound / np.maximum(distance, 1e-20))[:, None]
        return RefinedSurface(foot + offset, faces, foot, normals)

    def to_grid(self, points: np.ndarray) -> np.ndarray:
        """Normalised frame to grid units, ``[N,3]``."""
        return (points - self.shift) / self.scale

    def _at_samples(self, values: np.ndarray) -> np.ndarray:
        """``values [V]`` on the initial surface, at the point closest to each sample of the shell: ``[N]``."""
        return np.einsum("nc,nc->n", values[self.faces[self.shell.face]], self.shell.weights)

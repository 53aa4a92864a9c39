"""Relief on a shape that is Φ on a grid: what the optimiser moves, and what keeps it within bounds.

Three things move: Φ, the deformation of the grid and the weights of FlexiCubes. Φ = Φ₀ − s·room·tanh(h / room), where
Φ₀ is the generator's field, s its slope, so that h is a height in the units of the object, and ``room`` what cap, walls
and gaps leave at the closest point of the initial surface. h is a smooth function of the latent variable in the manner
of Nicolet et al. 2021: (I + λL) h = u, with L the Laplacian of the grid's own graph, of which only a shell about the
surface is kept. The deformation and the weights add what is smaller than a cell; their steps are small and those of the
deformation grow, as in GenMF.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from genmf_mi.geometry.low_pass import low_pass
from genmf_mi.geometry.mesh import ImplicitDiffusion
from genmf_mi.geometry.parameterization import Crossings, Geometry, RefinedSurface
from genmf_mi.geometry.sdf_distance import FieldDistance, slope, weights_of
from genmf_mi.losses import sdf as losses
from genmf_mi.mesh.nearest import Nearest, barycentric
from genmf_mi.sdf.flexicubes import WEIGHTS, FlexiCubes, flexi_weight_reg
from genmf_mi.sdf.grid import SPECK, without_specks
from genmf_mi.sdf.shell import shell

if TYPE_CHECKING:
    from genmf_mi.assets.sdf_asset import SdfAsset
    from genmf_mi.core.frame import Frame

DEFORMATION_RATE, WEIGHTS_RATE = 4.0, 4.0
"""Steps on the latent numbers of the deformation (in the end; see :meth:`SdfParameterization.rates`) and of the weights, which
have no unit, as multiples of the learning rate."""
FREE = 0.25
"""Share of a cell that a sample may move along each axis."""
REACH_CELLS, GROWTH, PATIENCE = 2.0, 1.5, 4
"""How far around a spot where the surface cuts through itself changes are taken back; by how much farther each time
that was not enough there; and the attempts after which no spot is new any more, so that there is an end to it."""


class SdfParameterization:
    """Φ, deformation and weights about a fixed initial surface; a :class:`genmf_mi.geometry.parameterization.Parameterization`.

    asset: whose ``surface(training=True)`` is the initial surface. frame: of the part.
    vertices, normals: ``[V,3]`` of that surface, normalised frame; faces: ``[F,3]``.
    inward, outward: ``[V]``, room along the normal, normalised units; where there is none, nothing moves.
    smoothing: λ. broad: length in normalised units; what is broader is taken out of the heights, see
        :class:`genmf_mi.geometry.mesh.MeshParameterization`.
    """

    def __init__(
        self,
        asset: SdfAsset,
        frame: Frame,
        vertices: np.ndarray,
        faces: np.ndarray,
        normals: np.ndarray,
        inward: np.ndarray,
        outward: np.ndarray,
        *,
        smoothing: float,
        broad: float,
        device: str = "cpu",
    ) -> None:
        def tensor(x: np.ndarray) -> Tensor:
            return torch.as_tensor(np.ascontiguousarray(x), dtype=torch.float32, device=device)

        self.device, self.vertices, self.faces, self.normals = device, vertices, faces, normals
        self.scale = asset.half * frame.scale
        self.shift = (np.asarray(asset.centre) - np.asarray(frame.centre)) * frame.scale
        self.room, self.cell = (inward, outward), 2 / asset.resolution * self.scale
        cap = max(inward.max(), outward.max()) / self.scale
        self.shell = shell(asset.phi < 0, asset.deformation, self._to_grid(vertices), faces, cap)
        around = self.shell
        count, cubes = len(around.samples), len(around.cubes)

        self.initial = tensor(asset.phi)
        self.samples = torch.as_tensor(around.samples, device=device)
        self.slope = tensor(slope(asset.phi, around.samples, around.distance))[:, None] / self.scale
        self.inward, self.outward = (tensor(self._spread(x))[:, None].clamp_min(1e-9) for x in (inward, outward))
        self.solve = ImplicitDiffusion(around.edges, count, smoothing, device)
        self.broad = low_pass(around.places * self.scale, around.edges, broad, device)

        m, step = len(asset.phi), 1 / asset.resolution
        at_rest = np.zeros((m, m, m, 3), np.float32) if asset.deformation is None else asset.deformation
        self.at_rest = tensor(at_rest).reshape(-1, 3)
        room = torch.minimum(self.inward, self.outward)
        spare = (step - self.at_rest[self.samples].abs()).clamp_min(0)
        self.limit = torch.minimum(spare.clamp_max(2 * FREE * step), room / self.scale)

        row = np.full(asset.resolution**3, -1, np.int32)
        row[around.cubes] = np.arange(cubes)
        self.extract = FlexiCubes(asset.spread, torch.as_tensor(row, device=device))
        self.weights = tensor(weights_of(asset, around.cubes))
        room = np.einsum("kc,kc->k", np.minimum(inward, outward)[faces[around.cube_face]], around.cube_weights)
        self.gate = tensor(np.clip(2 * room / self.cell, 0, 1))[:, None]

        ends = np.cumsum([0, count, 3 * count, WEIGHTS * cubes])
        self.blocks = tuple(slice(int(a), int(b)) for a, b in itertools.pairwise(ends))
        self.latent = torch.zeros(int(ends[-1]), device=device, requires_grad=True)

    def rates(self, progress: float) -> tuple[float, ...]:
        """All of the learning rate for Φ, and for the deformation little but ever more."""
        return 1.0, DEFORMATION_RATE * progress, WEIGHTS_RATE

    def heights(self) -> Tensor:
        """``[N,1]`` by which the surface is raised at the samples of the shell, normalised units, within the room."""
        x = self.solve(self.latent[self.blocks[0]][:, None])
        if self.broad is not None:
            x = x - self.broad(x)
        room = torch.where(x > 0, self.outward, self.inward)
        return room * torch.tanh(x / room)

    def fields(self, kept: tuple[Tensor, ...] | None = None) -> tuple[Tensor, Tensor, Tensor]:
        """Φ ``[m,m,m]``, deformation ``[m,m,m,3]`` and weights ``[K,21]`` of the cubes in the shell.

        kept: shares of the changes of each to keep, ``[N,1]``, ``[N,1]`` and ``[K,1]``; all of them if None.
        """
        change = -self.slope * self.heights()
        bent = self.limit * torch.tanh(self.latent[self.blocks[1]].view(-1, 3))
        weights = self.gate * self.latent[self.blocks[2]].view(-1, WEIGHTS)
        if kept is not None:
            change, bent, weights = kept[0] * change, kept[1] * bent, kept[2] * weights
        phi = self.initial.reshape(-1).index_add(0, self.samples, change[:, 0])
        deformation = self.at_rest.index_add(0, self.samples, bent)
        return phi.view_as(self.initial), deformation.view(*self.initial.shape, 3), self.weights + weights

    def moved(self) -> Geometry:
        """The extracted surface, Φ, and the losses of both."""
        phi, deformation, weights = self.fields()
        surface = self.extract(phi, deformation, weights)
        step = 2 / (len(phi) - 1)
        terms = {
            "sdf_tv": losses.sdf_tv(phi, self.samples, step),
            "l_dev": losses.l_dev(surface.deviation, step),
            "flexi_weight_reg": flexi_weight_reg(surface.weights),
        }
        shift = torch.as_tensor(self.shift, dtype=torch.float32, device=self.device)
        return Geometry(surface.vertices * self.scale + shift, surface.faces, phi, terms)

    def start_from(self, heights: np.ndarray) -> None:
        """Make :meth:`heights` the ``heights [V]`` of the closest points, up to 0.98 of the room and but for their
        broad part; nothing else moves."""
        with torch.no_grad():
            wanted = torch.as_tensor(self._spread(heights), dtype=torch.float32, device=self.device)[:, None]
            room = torch.where(wanted > 0, self.outward, self.inward)
            x = room * torch.atanh((wanted / room).clamp(-0.98, 0.98))
            self.latent.zero_()
            self.latent[self.blocks[0]] = self.solve.inverse(x)[:, 0]

    def distance(self, samples: int) -> Callable[[Tensor], Tensor]:
        """See :class:`genmf_mi.geometry.sdf_distance.FieldDistance`."""
        return FieldDistance(self, samples)

    def reached(self) -> np.ndarray:
        """The latent as an array."""
        return self.latent.detach().cpu().numpy().copy()

    def displaced(self, heights: np.ndarray) -> np.ndarray:
        """The latent of :meth:`start_from`, with the broad part of the heights."""
        self.broad = None
        self.start_from(heights)
        return self.reached()

    def surface(self, reached: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Vertices ``[V,3]`` and faces ``[F,3]`` within their room, but not untangled."""
        part = self._part(reached, None)
        return part.vertices, part.faces

    def finished(self, reached: np.ndarray, crossings: Crossings) -> RefinedSurface:
        """Take changes of the fields back around faces that cut through others, and extract again, until no more of
        them are left than the initial surface has. First go deformation and weights, as these make faces cross within
        a cell; where that is not enough half of the change of Φ, then all of it, ever farther around the spot."""
        from scipy.spatial import cKDTree

        def around(vertices: np.ndarray, faces: np.ndarray) -> cKDTree:
            return cKDTree(self._to_grid(vertices[np.unique(faces)]))

        own = crossings(self.vertices, self.faces)
        first, failed, always = None, [], around(self.vertices, self.faces[own])
        places = self.shell.places, self.shell.places, self.shell.centres
        kept = tuple(np.ones(len(x)) for x in places)
        near = REACH_CELLS * self.cell / self.scale
        for attempt in itertools.count():
            part = self._part(reached, kept)
            crossing = crossings(part.vertices, part.faces)
            first = len(crossing) if first is None else first
            if len(crossing) <= len(own) or not any(share.any() for share in kept):
                break
            spots = around(part.vertices, part.faces[crossing])
            new = always.query(spots.data)[0] > near
            spots = cKDTree(spots.data[new]) if new.any() else spots
            times = np.full(spots.n, attempt // PATIENCE) + sum(x.query(spots.data)[0] < near for x in failed)
            failed.append(spots)
            for again in np.unique(times):
                there, reach = cKDTree(spots.data[times == again]), near * GROWTH ** max(again - 1, 0)
                for share, at, taken in zip(kept, places, (min(again / 2, 1), 1, 1), strict=True):
                    away = there.query(at, distance_upper_bound=reach)[0] / reach
                    share *= 1 - taken * np.clip(2 - 2 * away, 0, 1)
        held = int((np.minimum(*kept[:2]) < 1).sum())
        report = {"self_intersections_before": len(own), "untangled": first, "samples_held_back": held}
        return RefinedSurface(part.vertices, part.faces, part.foot, part.normals, report)

    def _part(self, reached: np.ndarray, kept: tuple[np.ndarray, ...] | None) -> RefinedSurface:
        """The surface without specks, every vertex within the room of its point on the initial one, to which weights
        and deformation do not keep by themselves. Bodies that were just large enough before are no specks now."""
        with torch.no_grad():
            self.latent.copy_(torch.as_tensor(reached))
            shares = kept and tuple(torch.as_tensor(x, dtype=torch.float32, device=self.device)[:, None] for x in kept)
            phi, *rest = self.fields(shares)
            phi = torch.as_tensor(without_specks(phi.cpu().numpy(), SPECK / 3)[0], device=self.device)
            made = self.extract(phi, *rest)
        faces = made.faces.cpu().numpy().astype(np.int64)
        points = made.vertices.cpu().numpy().astype(np.float64) * self.scale + self.shift
        face, foot, away = Nearest(self.vertices, self.faces).find(points)
        corners, weights = self.faces[face], barycentric(self.vertices[self.faces[face]], foot)

        def there(field: np.ndarray) -> np.ndarray:
            return np.einsum("vc,vc...->v...", weights, field[corners])

        normals = there(self.normals)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-20)
        offset = points - foot
        raised = np.einsum("vk,vk->v", offset, normals) > 0
        room = np.where(raised, *(there(x) for x in self.room[::-1]))
        offset *= np.minimum(1, room / np.maximum(away, 1e-20))[:, None]
        return RefinedSurface(foot + offset, faces, foot, normals)

    def _to_grid(self, points: np.ndarray) -> np.ndarray:
        """Normalised frame to grid units, ``[N,3]``."""
        return (points - self.shift) / self.scale

    def _spread(self, values: np.ndarray) -> np.ndarray:
        """``values [V]`` on the initial surface, at the point closest to each sample of the shell: ``[N]``."""
        return np.einsum("nc,nc->n", values[self.faces[self.shell.face]], self.shell.weights)

"""The stress field on a coarse mesh: what the compact network is told of the part as a whole.

A network with four poolings that sees some hundred shapes does not learn elasticity. A mesh of :data:`EDGE_MM` has the
thermal load, the clamp and the bending of the part right to some hundredths, in a few seconds. The network adds what is
finer. Both have derivatives: those of the solver come from its adjoint, at the price of one more solve.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from genmf_mi.core.errors import SolidError
from genmf_mi.core.frame import Frame
from genmf_mi.sdf.distance import sample
from genmf_mi.stress.fem import sensitivity, tetrahedra
from genmf_mi.stress.fem import simulation as fem
from genmf_mi.stress.fem.grid import locate_points

EDGE_MM = 2.5
"""Side of the lattice that the tetrahedra come from, on a part of 100 mm."""
HELD, FINER = 0.9, (1.0, 0.7, 0.5)
"""Share of the body's volume that a mesh must hold, and the shares of the edge that are tried one after the other until
one does: thin walls fall through a coarse mesh, and what is left of the body says nothing of it. Thin bodies have few
cells, so that a fine mesh costs no more."""
BEYOND_CELLS = 8.0
"""How far outside of the body there is a value, that of the nearest point inside: relief may grow that far."""


def coarse_stress(phi: Tensor, settings: fem.Settings, edge_mm: float = EDGE_MM) -> Tensor:
    """Von Mises in MPa ``[1,n,n,n]`` of the body Φ < 0 on a coarse mesh; smooth across the surface, differentiable.

    All zero if the mesh is too coarse to hold anything of the body.

    Args:
        phi: ``[1,n,n,n]`` on the grid [-1, 1]³.
        settings: how the part is simulated; their ``edge_mm`` is not used.
        edge_mm: for a longest side of 100 mm, in proportion for others.

    Raises:
        SolveError: a solve did not converge.
    """
    return _CoarseStress.apply(phi, settings, edge_mm)


class CoarseBody:
    """The solver's field of Φ ``[n,n,n]`` on a coarse mesh, and which changes of Φ change it.

    stress: von Mises in MPa, float32 ``[n,n,n]``.

    Raises:
        SolidError: the mesh holds nothing of the body. SolveError: a solve did not converge.
    """

    def __init__(self, phi: np.ndarray, settings: fem.Settings, edge_mm: float) -> None:
        self.phi, self.mm = phi, Frame((0.0, 0.0, 0.0), 1.0, settings.size_mm).mm_per_unit
        self.edge, self.mesh = _stuffed(phi, edge_mm * settings.size_mm / 100.0 / self.mm)
        self.problem = fem.Problem(
            self.mesh.moved(self._to_print(self.mesh.points)), fem.material(settings.material), settings.protocol
        )
        self.field = self.problem.solve()
        self.places = locate_points(self.mesh, phi - BEYOND_CELLS * self._cell)
        self.stress = self.places.to_grid(self.mesh, self.field.von_mises_nodes, phi.shape[0])

    @property
    def _cell(self) -> float:
        return 2.0 / (self.phi.shape[0] - 1)

    def by_phi(self, gradient: np.ndarray) -> np.ndarray:
        """Derivative of a scalar with respect to Φ from that with respect to ``stress``, ``[n,n,n]`` both.

        A node of the surface goes where the surface about it goes: by -n/|∇Φ| times the mean of the change of Φ within
        an edge of it. What is finer, the mesh does not see.
        """
        from scipy.spatial import cKDTree

        by_nodes = sensitivity.by_nodes(
            self.problem,
            self.field,
            self.places.cell,
            self._to_print(self.places.point),
            gradient.reshape(-1)[self.places.sample].astype(np.float64),
        )
        by_nodes = sensitivity.by_surface(self.problem, by_nodes)
        nodes = np.unique(self.problem.elements.boundary)
        points = self.mesh.points[nodes]
        near = np.abs(self.phi) < self._cell
        slopes = np.gradient(self.phi.astype(np.float64), self._cell)
        there = np.stack([slope[near] for slope in slopes], axis=1)
        here = np.stack([sample(slope, points) for slope in slopes], axis=1)
        length = np.linalg.norm(here, axis=1).clip(0.1)

        samples = np.argwhere(near) * self._cell - 1.0
        pairs = cKDTree(points).sparse_distance_matrix(cKDTree(samples), self.edge, output_type="coo_matrix")
        row, column = pairs.row, pairs.col
        alike = (here[row] * there[column]).sum(axis=1).clip(0)  # not the other side of a wall
        weight = (1 - pairs.data / self.edge) * (1 - np.abs(self.phi[near])[column] / self._cell) * alike
        total = np.bincount(row, weight, len(nodes))
        along = -(self._from_print(by_nodes[nodes]) * here).sum(axis=1) / length**2
        share = along / np.where(total > 0, total, np.inf)
        result = np.zeros(self.phi.shape)
        result[near] = np.bincount(column, weight * share[row], len(samples))
        return result

    def _to_print(self, points: np.ndarray) -> np.ndarray:
        """As :meth:`Frame.to_print`, but for where the base is, which for the nodes alone is the same."""
        mm = points * self.mm
        return np.stack([mm[:, 0], -mm[:, 2], mm[:, 1]], axis=1)

    def _from_print(self, gradient: np.ndarray) -> np.ndarray:
        """A derivative per mm in the frame of the printer as one in the normalised frame, ``[N,3]``."""
        return np.stack([gradient[:, 0], gradient[:, 2], -gradient[:, 1]], axis=1) * self.mm


def _stuffed(phi: np.ndarray, edge: float) -> tuple[float, tetrahedra.TetMesh]:
    """The coarsest mesh that holds the body, or the finest that was tried, and its edge. Raises :class:`SolidError` if
    there is nothing in any."""
    cell = 2.0 / (phi.shape[0] - 1)
    volume = np.clip(0.5 - phi / cell, 0, 1).sum() * cell**3
    for share in FINER:
        try:
            mesh, _ = tetrahedra.largest_body(tetrahedra.isosurface_stuffing(phi, share * edge))
        except SolidError:
            if share == FINER[-1]:
                raise
            continue
        if mesh.volumes.sum() > HELD * volume:
            break
    return share * edge, mesh


class _CoarseStress(torch.autograd.Function):
    @staticmethod
    def forward(ctx, phi: Tensor, settings: fem.Settings, edge_mm: float) -> Tensor:
        try:
            body = CoarseBody(phi.detach().cpu()[0].numpy(), settings, edge_mm)
        except SolidError:
            ctx.body = None
            return torch.zeros_like(phi)
        ctx.body = body if ctx.needs_input_grad[0] else None
        return torch.from_numpy(body.stress)[None].to(phi)

    @staticmethod
    def backward(ctx, gradient: Tensor) -> tuple[Tensor, None, None]:
        if ctx.body is None:
            return torch.zeros_like(gradient), None, None
        by_phi = ctx.body.by_phi(gradient.detach().cpu()[0].numpy())
        return torch.from_numpy(by_phi)[None].to(gradient), None, None

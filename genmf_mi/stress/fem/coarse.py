"""The stress field on a coarse mesh, from which the compact network learns how the part as a whole is loaded.

A network with four poolings that is trained on some hundred shapes does not learn elasticity. A mesh of
:data:`EDGE_MM` has the thermal load, the clamp and the bending of the part right to some hundredths, in a few
seconds. The network adds what is finer. Both have derivatives: those of the solver come from its adjoint, at the price
of one more solve.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from genmf_mi.core.errors import SolidError
from genmf_mi.core.frame import Frame
from genmf_mi.sdf.distance import sample
from genmf_mi.stress.fem import materials, sensitivity
from genmf_mi.stress.fem.body_mesh import MIN_VOLUME_SHARE, volume
from genmf_mi.stress.fem.grid import locate_points
from genmf_mi.stress.fem.problem import Problem
from genmf_mi.stress.fem.settings import Settings
from genmf_mi.stress.fem.tet_mesh import TetMesh, largest_component
from genmf_mi.stress.fem.tetrahedra import isosurface_stuffing

EDGE_MM = 2.5
"""Side of the lattice that the tetrahedra come from, on a part of 100 mm."""
EDGE_SHARES = (1.0, 0.7, 0.5)
"""Shares of the edge that are tried one after the other until a mesh holds enough of the body
(:data:`genmf_mi.stress.fem.body_mesh.MIN_VOLUME_SHARE`). Thin bodies have few cells: a fine mesh costs no more."""
BEYOND_CELLS = 8.0
"""How far outside of the body the field is continued, by the value of the nearest point inside: relief may grow that
far. In cells of the grid."""
_MIN_SLOPE = 0.1
"""Lower bound of |∇Φ| at a node, which is 1 for a distance but falls to 0 at a medial axis."""


def coarse_stress(phi: Tensor, settings: Settings, edge_mm: float = EDGE_MM) -> Tensor:
    """Von Mises in MPa ``[1,n,n,n]`` of the body Φ < 0 on a coarse mesh; smooth across the surface, differentiable.

    All zero if the mesh is too coarse to hold anything of the body.

    Args:
        phi: ``[1,n,n,n]`` on the grid [-1, 1]³.
        settings: how the part is simulated; their ``edge_mm`` is not used.
        edge_mm: for a longest side of 100 mm, in proportion for others.

    Raises:
        SolveError: a solve did not converge.
    """
    stress: Any = _CoarseStress.apply(phi, settings, edge_mm)
    return stress


class CoarseBody:
    """The solver's field of Φ ``[n,n,n]`` on a coarse mesh, and its derivative with respect to Φ.

    mm: per normalised unit. edge: that of the mesh, in normalised units. stress: von Mises in MPa, float32 ``[n,n,n]``.

    Raises:
        SolidError: the mesh holds nothing of the body. SolveError: a solve did not converge.
    """

    def __init__(self, phi: np.ndarray, settings: Settings, edge_mm: float) -> None:
        self.phi, self.frame = phi, Frame((0.0, 0.0, 0.0), 1.0, settings.size_mm)
        self.mm = self.frame.mm_per_unit
        self.edge, self.mesh = _coarse_mesh(phi, edge_mm * settings.size_mm / 100.0 / self.mm)
        printed = self.mesh.with_points(self._to_print(self.mesh.points))
        self.problem = Problem(printed, materials.material(settings.material), settings.protocol)
        self.field = self.problem.solve()
        self.location = locate_points(self.mesh, phi - BEYOND_CELLS * self._cell)
        self.stress = self.location.to_grid(self.mesh, self.field.von_mises_nodes, phi.shape[0])

    @property
    def _cell(self) -> float:
        """Side of a cell of the grid, in normalised units."""
        return 2.0 / (self.phi.shape[0] - 1)

    def phi_gradient(self, gradient: np.ndarray) -> np.ndarray:
        """Derivative of a scalar J with respect to Φ from that with respect to ``stress``, ``[n,n,n]`` both.

        Where Φ changes by δΦ, its zero level set moves by −∇Φ δΦ / |∇Φ|² (from Φ + δΦ + ∇Φ·δx = 0). A node i of the
        surface moves with the change of Φ about it, a Nadaraya–Watson average over the samples j of the grid:

            δx_i = −∇Φ_i / |∇Φ_i|² · Σ_j w_ij δΦ_j / Σ_j w_ij
            w_ij = (1 − |x_i − x_j| / h)₊ (1 − |Φ_j| / c)₊ (∇Φ_i·∇Φ_j)₊

        with h the edge of the mesh and c the cell of the grid. The first factor is a cone kernel, as wide as the shape
        function of the node: the mesh does not resolve what is finer. The second is a hat function as a regularised δ
        of the surface, within one cell. The third leaves out the other side of a thin wall. By the chain rule,

            ∂J/∂Φ_j = Σ_i (∂J/∂x_i · −∇Φ_i / |∇Φ_i|²) w_ij / Σ_k w_ik

        where ∂J/∂x_i is the derivative with respect to the nodes of the surface, the inner ones moving along
        (:func:`genmf_mi.stress.fem.sensitivity.surface_gradient`).

        Raises:
            SolveError: a solve did not converge.
        """
        nodes = np.unique(self.problem.elements.boundary)
        slopes = np.stack([*np.gradient(self.phi.astype(np.float64), self._cell)])
        node_slope = np.stack([sample(slope, self.mesh.points[nodes]) for slope in slopes], axis=1)
        length = np.linalg.norm(node_slope, axis=1).clip(_MIN_SLOPE)
        by_offset = -(self._surface_gradient(gradient)[nodes] * node_slope).sum(axis=1) / length**2

        near = np.abs(self.phi) < self._cell
        node, near_sample, weight = self._kernel(self.mesh.points[nodes], node_slope, near, slopes[:, near].T)
        total = np.bincount(node, weight, len(nodes))
        per_weight = by_offset / np.where(total > 0, total, np.inf)
        result = np.zeros(self.phi.shape)
        result[near] = np.bincount(near_sample, weight * per_weight[node], int(near.sum()))
        return result

    def _surface_gradient(self, gradient: np.ndarray) -> np.ndarray:
        """Derivative with respect to the nodes of the surface per normalised unit, ``[N,3]``; zero inside."""
        read = sensitivity.read_at(
            self.location.cell,
            self._to_print(self.location.point),
            gradient.reshape(-1)[self.location.sample].astype(np.float64),
        )
        nodal = sensitivity.nodal_gradient(self.problem, self.field, read)
        printed = sensitivity.surface_gradient(self.problem, nodal)
        return self.frame.turned_from_print(printed) * self.mm

    def _kernel(
        self, nodes: np.ndarray, node_slope: np.ndarray, near: np.ndarray, sample_slope: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The pairs with a w_ij of :meth:`phi_gradient`: node, sample (a number among ``near``), weight, ``[P]`` each.

        Args:
            nodes, node_slope: points of the surface and ∇Φ there, ``[S,3]``.
            near: samples within a cell of the surface, bool ``[n,n,n]``; sample_slope: ∇Φ there, ``[M,3]``.
        """
        from scipy.spatial import KDTree

        samples = np.argwhere(near) * self._cell - 1.0
        pairs = KDTree(nodes).sparse_distance_matrix(KDTree(samples), self.edge, output_type="coo_matrix")
        node, near_sample = pairs.row, pairs.col
        cone = 1 - pairs.data / self.edge
        hat = (1 - np.abs(self.phi[near]) / self._cell)[near_sample]
        alignment = (node_slope[node] * sample_slope[near_sample]).sum(axis=1).clip(0)
        return node, near_sample, cone * hat * alignment

    def _to_print(self, points: np.ndarray) -> np.ndarray:
        """As :meth:`Frame.to_print` without moving the base to z = 0: the nodes and the points of
        :class:`PointLocation` must be in one frame."""
        return self.frame.turned_to_print(points) * self.mm


def _coarse_mesh(phi: np.ndarray, edge: float) -> tuple[float, TetMesh]:
    """The coarsest mesh that holds the body, or the finest that was tried, and its edge.

    Raises:
        SolidError: not even the finest holds anything of the body.
    """
    least = MIN_VOLUME_SHARE * volume(phi)
    for share in EDGE_SHARES[:-1]:
        try:
            mesh, _ = largest_component(isosurface_stuffing(phi, share * edge))
        except SolidError:
            continue
        if mesh.volumes.sum() > least:
            return share * edge, mesh
    edge *= EDGE_SHARES[-1]
    return edge, largest_component(isosurface_stuffing(phi, edge))[0]


class _CoarseStress(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, phi: Tensor, settings: Settings, edge_mm: float) -> Tensor:
        try:
            body = CoarseBody(phi.detach().cpu()[0].numpy(), settings, edge_mm)
        except SolidError:
            ctx.body = None
            return torch.zeros_like(phi)
        ctx.body = body if ctx.needs_input_grad[0] else None
        return torch.from_numpy(body.stress)[None].to(phi)

    @staticmethod
    def backward(ctx: Any, *grad_outputs: Tensor) -> tuple[Tensor, None, None]:
        (gradient,) = grad_outputs
        if ctx.body is None:
            return torch.zeros_like(gradient), None, None
        by_phi = ctx.body.phi_gradient(gradient.detach().cpu()[0].numpy())
        return torch.from_numpy(by_phi)[None].to(gradient), None, None

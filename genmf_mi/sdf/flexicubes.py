"""FlexiCubes: a closed mesh from Φ on a grid, differentiable in all of its inputs.

Shen et al., *Flexible Isosurface Extraction for Gradient-Based Mesh Optimization* (SIGGRAPH 2023): dual marching cubes
whose vertices can move inside their cubes by weights, on a grid that can be deformed. With n cubes per axis:

* ``phi [m,m,m]``, m = n + 1, indexed x, y, z, negative inside; the grid spans [-1, 1]³ as in
  :mod:`genmf_mi.sdf.distance`.
* ``deformation [m,m,m,3]``: displacement of the samples, normalised units; within half a cell (1 / n), so that no cell
  folds.
* ``weights [n³,21]``: per cube, x, y, z in the order of ``phi``, and in a row as generators store them: β of the 12
  edges, α of the 8 corners, γ. They are unbounded; :func:`bounded_weights` maps them to their ranges, and zeros are
  neutral.

Where Φ is negative on the border of the grid, the mesh is open there. Everywhere else it is closed, every edge has two
faces and every vertex one fan of them, whatever the field (see :mod:`genmf_mi.sdf.cube_cases`).
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from genmf_mi.sdf.dual_topology import Topology, topology

BETA, ALPHA, GAMMA = slice(0, 12), slice(12, 20), slice(20, 21)
"""The columns of each kind among the 21 weights of a cube."""
WEIGHTS = 21
"""Weights per cube."""


class Weights(NamedTuple):
    """Positive weights of S cubes: alpha ``[S,8]``, beta ``[S,12]``, gamma ``[S]``."""

    alpha: Tensor
    beta: Tensor
    gamma: Tensor


class Surface(NamedTuple):
    """An extracted surface.

    vertices: ``[V,3]``, normalised units; the first D are the dual vertices.
    faces: ``[F,3]``, oriented outwards.
    deviation: ``[D]``, normalised units; its mean is L_dev, the first term of L_reg.
    weights: ``[S,21]``, the unbounded weights of the cubes that intersect the surface.
    """

    vertices: Tensor
    faces: Tensor
    deviation: Tensor
    weights: Tensor


class FlexiCubes:
    """Extracts surfaces; the topology, which depends on the signs alone, is kept between calls.

    spread: how far α and β can deviate from one, below 1; InstantMesh has 0.5, TRELLIS 0.99.
    rows: ``[n³]``, which row of the weights a cube has, -1 for none: few cubes ever intersect the surface, and 21
        weights for all of 256³ are 1.4 GB. None if every cube has its own.
    """

    def __init__(self, spread: float = 0.99, rows: Tensor | None = None) -> None:
        self.spread, self.rows = spread, rows
        self.topology: Topology | None = None

    def __call__(
        self, phi: Tensor, deformation: Tensor | None = None, weights: Tensor | None = None, *, training: bool = True
    ) -> Surface:
        """The surface Φ = 0.

        Args:
            phi: ``[m,m,m]``.
            deformation: ``[m,m,m,3]`` or None.
            weights: ``[n³,21]``, or ``[K,21]`` with ``rows``, or None.
            training: split each quad into four triangles about a point weighted by γ, which is differentiable in γ;
                otherwise into two along the diagonal with the larger product of γ.
        """
        inside = phi.detach() < 0
        if self.topology is None or not torch.equal(inside, self.topology.inside):
            self.topology = topology(inside)
        shape = self.topology
        raw = self._select(shape.cubes, weights) if weights is not None else phi.new_zeros(len(shape.cubes), WEIGHTS)
        bounded = bounded_weights(raw, self.spread)
        vertices, deviation = dual_vertices(shape, phi, deformation, bounded)
        vertices, faces = triangles(shape, vertices, bounded.gamma, training=training)
        return Surface(vertices, faces, deviation, raw)

    def _select(self, cubes: Tensor, weights: Tensor) -> Tensor:
        """The weights ``[S,21]`` of the ``cubes [S]``, zeros for cubes that have none."""
        if self.rows is None:
            return weights.index_select(0, cubes)
        row = self.rows[cubes].long()
        return weights.index_select(0, row.clamp_min(0)) * (row >= 0)[:, None]


def bounded_weights(raw: Tensor, spread: float = 0.99) -> Weights:
    """``[S,21]`` to α, β in 1 ± ``spread`` by tanh, and γ in (1 ± ``spread``) / 2 by the logistic function."""
    beta, alpha = (1 + spread * torch.tanh(raw[:, part]) for part in (BETA, ALPHA))
    return Weights(alpha, beta, spread * torch.sigmoid(raw[:, GAMMA].squeeze(1)) + (1 - spread) / 2)


def dual_vertices(shape: Topology, phi: Tensor, deformation: Tensor | None, weights: Weights) -> tuple[Tensor, Tensor]:
    """The vertices ``[D,3]`` and the mean absolute deviation ``[D]`` of their distances to the adjacent crossings.

    A crossing u_e is where Φ, with α as a factor at the two ends, is zero on an edge; a vertex is Σ β u_e / Σ β over
    the crossings of its patch.
    """
    m, count = phi.shape[0], len(shape.owner)
    value = phi.reshape(-1).index_select(0, shape.ends.reshape(-1)).reshape(-1, 1, 2)
    index = torch.stack([shape.ends // m**2, shape.ends // m % m, shape.ends % m], dim=2)
    place = index.to(phi) * (2 / (m - 1)) - 1
    if deformation is not None:
        place = place + deformation.reshape(-1, 3).index_select(0, shape.ends.reshape(-1)).reshape(-1, 2, 3)

    level = value * weights.alpha.reshape(-1).index_select(0, shape.corners.reshape(-1)).reshape(-1, 4, 2)
    share = level[:, :, 0] / (level[:, :, 0] - level[:, :, 1])
    start, along = place[:, None, 0], (place[:, 1] - place[:, 0])[:, None]
    crossing = (start + share[:, :, None] * along).reshape(-1, 3)
    beta = weights.beta.reshape(-1).index_select(0, shape.edge.reshape(-1))

    vertex = shape.vertex.reshape(-1)

    def per_vertex(x: Tensor) -> Tensor:
        return x.new_zeros(count + 1, *x.shape[1:]).index_add(0, vertex, x)

    def per_crossing(x: Tensor) -> Tensor:
        return x.index_select(0, vertex)

    # The last row collects what belongs to no vertex; a one avoids 0 / 0 there
    no_vertex = torch.zeros(count + 1, dtype=phi.dtype, device=phi.device)
    no_vertex[count] = 1
    vertices = per_vertex(beta[:, None] * crossing) / (per_vertex(beta) + no_vertex)[:, None]
    number = per_vertex(torch.ones_like(beta)) + no_vertex
    distance = (crossing - per_crossing(vertices)).norm(dim=1)
    deviation = per_vertex((distance - per_crossing(per_vertex(distance) / number)).abs()) / number
    return vertices[:count], deviation[:count]


def triangles(shape: Topology, vertices: Tensor, gamma: Tensor, *, training: bool) -> tuple[Tensor, Tensor]:
    """Vertices ``[V,3]``, the dual ones first, and faces ``[F,3]``; ``gamma [S]`` determines how a quad is split."""
    quads, weight = shape.quads, gamma[shape.owner]
    weight = weight.index_select(0, quads.reshape(-1)).reshape(-1, 4)
    first, second = weight[:, 0] * weight[:, 2], weight[:, 1] * weight[:, 3]
    a, b, c, d = quads.T
    if not training:
        straight = (first >= second)[:, None]
        halves = [
            torch.where(straight, torch.stack(one, 1), torch.stack(other, 1))
            for one, other in (((a, b, c), (a, b, d)), ((a, c, d), (b, c, d)))
        ]
        return vertices, torch.cat(halves)
    corner = vertices.index_select(0, quads.reshape(-1)).reshape(-1, 4, 3)
    middle = first[:, None] * (corner[:, 0] + corner[:, 2]) + second[:, None] * (corner[:, 1] + corner[:, 3])
    middle = middle / (2 * (first + second))[:, None]
    e = len(vertices) + torch.arange(len(quads), device=quads.device)
    fans = [torch.stack(corners, dim=1) for corners in ((a, b, e), (b, c, e), (c, d, e), (d, a, e))]
    return torch.cat([vertices, middle]), torch.cat(fans)

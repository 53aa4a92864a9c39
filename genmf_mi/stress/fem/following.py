"""The stress of a body whose surface moves a little: one mesh for many looks, whose nodes follow the surface.

Meshing anew would cost as much as solving, and would add a jump of the discretisation to every difference. What two
looks share is computed once: the cells and all that follows from them, and the multigrid hierarchy of the body as it
was; the solves start from its solution. Look and derivative do not depend on the looks before.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from genmf_mi.core.frame import Frame
from genmf_mi.losses import stress as losses
from genmf_mi.sdf.distance import sample
from genmf_mi.stress.fem import materials
from genmf_mi.stress.fem.body_mesh import MOST_NODES, body_mesh
from genmf_mi.stress.fem.linear import SolveError
from genmf_mi.stress.fem.problem import Field, Problem
from genmf_mi.stress.fem.sensitivity import nodal_gradient
from genmf_mi.stress.fem.settings import Settings
from genmf_mi.stress.fem.shape_functions import ShapeFunctions
from genmf_mi.stress.fem.statistics import SURFACE_BAND_MM
from genmf_mi.stress.fem.tet_mesh import TetMesh

LOOK_TOLERANCE = 1e-5
"""Relative residual of the equilibrium of a look."""
REACH = 2.0
"""Edges below the surface at which nodes stay where they are."""
SMALLEST_CELL = 0.2
"""Share of its volume that no cell may fall below; the nodes around it then follow less."""
_HALVINGS = 6
MEASURES = ("stress_mean", "stress_variance", "stress_band", "stress_peak")
"""E and Var over the body, E over the layer within 4 mm of the initial surface, and a smooth stand-in for the maximum,
(E σ⁸)^⅛."""


class FollowingBody:
    """The body Φ < 0, and what its stress is once its surface has moved.

    points: nodes of the mesh, ``[N,3]`` in the normalised frame. reach: as deep below the surface they follow it.

    Args:
        phi: ``[n,n,n]``, normalised frame. frame: of the part, its size and the way it is printed.
        settings: material and protocol; its edge and size are not used.
        nodes: of the mesh, about, unless that would be finer than :data:`genmf_mi.stress.fem.body_mesh.FINEST`.
        tolerance: relative residual of the equilibrium.

    Raises:
        SolidError: the mesh holds nothing of the body. SolveError: a solve did not converge.
    """

    def __init__(
        self,
        phi: np.ndarray,
        frame: Frame,
        settings: Settings,
        nodes: int = MOST_NODES,
        tolerance: float = LOOK_TOLERANCE,
    ) -> None:
        self._frame, self._tolerance = frame, tolerance
        self._mesh, edge = body_mesh(phi, nodes)
        self.points, self.reach = self._mesh.points, REACH * edge
        self._printed = frame.turned_to_print(self.points) * frame.mm_per_unit
        self._volumes = self._mesh.with_points(self._printed).volumes
        middles = self.points[self._mesh.cells].mean(axis=1)
        self._layer = torch.from_numpy((sample(phi, middles) * frame.mm_per_unit > -SURFACE_BAND_MM).astype(np.float64))
        self._material, self._protocol = materials.material(settings.material), settings.protocol
        self._still = Problem(self._at(self._printed), self._material, self._protocol)
        self._field = self._still.solve()

    def measures(self, motion: Tensor) -> Tensor:
        """The :data:`MEASURES` ``[4]`` in MPa, the variance in MPa², differentiable with respect to ``motion [N,3]`` of
        the nodes in normalised units; inner nodes are expected to follow too.

        Where a cell would be crushed, its nodes follow less.

        Raises:
            SolveError: a solve did not converge.
        """
        return _Measures.apply(motion, self)  # pyright: ignore[reportUnknownMemberType]

    def solve(self, motion: np.ndarray) -> tuple[Problem, Field, np.ndarray]:
        """The problem and its field after a ``motion [N,3]`` in normalised units, and by how much each node follows it,
        ``[N]``."""
        moved = self._frame.turned_to_print(motion) * self._frame.mm_per_unit
        follows = self._follows(moved)
        if not np.any(moved):
            return self._still, self._field, follows
        mesh = self._at(self._printed + follows[:, None] * moved)
        problem = Problem(mesh, self._material, self._protocol, self._still, self._tolerance)
        try:
            return problem, problem.solve(), follows
        except SolveError:  # too far from where it was for the hierarchy of that
            problem = Problem(mesh, self._material, self._protocol)
            return problem, problem.solve(), follows

    def measure(self, elements: ShapeFunctions[Tensor], von_mises: Tensor) -> Tensor:
        """The :data:`MEASURES` of a field given in each cell, ``[4]``."""
        volumes = elements.volumes
        return torch.stack([
            losses.mean(von_mises, volumes),
            losses.variance(von_mises, volumes),
            losses.mean(von_mises, volumes * self._layer),
            losses.peak(von_mises, volumes),
        ])  # fmt: skip

    def gradient(self, problem: Problem, field: Field, follows: np.ndarray, weights: Tensor) -> np.ndarray:
        """Derivative of Σ weights · :data:`MEASURES` with respect to the motion of the nodes, ``[N,3]``."""
        nodal = nodal_gradient(problem, field, lambda elements, value: (weights * self.measure(elements, value)).sum())
        return self._frame.turned_from_print(follows[:, None] * nodal) * self._frame.mm_per_unit

    def _at(self, points_mm: np.ndarray) -> TetMesh:
        return self._mesh.with_points(points_mm - [0, 0, points_mm[:, 2].min()])

    def _follows(self, moved_mm: np.ndarray) -> np.ndarray:
        """By how much each node may follow the surface, ``[N]`` in 0..1, so that no cell is crushed."""
        follows = np.ones(len(moved_mm))
        for _ in range(_HALVINGS):
            volumes = self._mesh.with_points(self._printed + follows[:, None] * moved_mm).volumes
            crushed = volumes < SMALLEST_CELL * self._volumes
            if not crushed.any():
                return follows
            follows[np.unique(self._mesh.cells[crushed])] *= 0.5
        follows[np.unique(self._mesh.cells[crushed])] = 0.0
        return follows


class _Measures(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, motion: Tensor, body: FollowingBody) -> Tensor:
        ctx.body, ctx.like = body, motion
        ctx.solved = body.solve(motion.detach().cpu().numpy().astype(np.float64))
        field: Field = ctx.solved[1]
        mesh = field.mesh
        elements = ShapeFunctions(torch.from_numpy(mesh.points), torch.from_numpy(mesh.cells))
        return body.measure(elements, torch.from_numpy(field.von_mises)).to(motion)

    @staticmethod
    def backward(ctx: Any, weights: Tensor) -> tuple[Tensor, None]:  # pyright: ignore[reportIncompatibleMethodOverride]
        gradient = ctx.body.gradient(*ctx.solved, weights.detach().cpu().double())
        return torch.from_numpy(gradient).to(ctx.like), None

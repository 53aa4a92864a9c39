"""How the solver's von Mises stress changes with the shape: the adjoint of :class:`genmf_mi.stress.fem.simulation.Problem`.

A scalar J(x, u, T) of the nodes x, the displacement u and the temperatures T_k, with residuals r = K(x) u − f(x, T)
and r_k = A(x) T_k − C(x) T_{k−1} − b(x) T_amb,k, has the derivative

    dJ/dx = ∂J/∂x − λ·∂r/∂x − Σ μ_k·∂r_k/∂x    with    K λ = ∂J/∂u,    A μ_k = C μ_{k+1} + [k is last] (∂J/∂T − λ·∂r/∂T)

All matrices are symmetric, so the systems of the forward solve are solved once more. What is differentiated with
respect to x is a sum over cells with everything else held, which torch does.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from genmf_mi.stress.fem.elasticity import soft_clamp
from genmf_mi.stress.fem.linear import jacobi, solve_spd
from genmf_mi.stress.fem.simulation import Field, Problem

HARMONIC = 1e-6
"""Relative residual of the motion of the nodes inside."""


@torch.enable_grad()
def by_nodes(problem: Problem, field: Field, cell: np.ndarray, point: np.ndarray, gradient: np.ndarray) -> np.ndarray:
    """Derivative of a scalar of the field with respect to the nodes of the mesh, ``[N,3]`` per mm.

    The clamp follows the lowest node, and its height that of the highest above it.

    Args:
        problem: solved; field: its solution.
        cell, point: where the scalar looks at the field, ``[M]`` and ``[M,3]``, in mm as the nodes; these stay.
        gradient: of the scalar with respect to von Mises in MPa there, ``[M]``.

    Raises:
        SolveError: a solve did not converge.
    """
    points, moved, excess = (
        torch.tensor(array, requires_grad=True) for array in (field.mesh.points, field.displacement, problem.excess[-1])
    )
    cells = _Cells(points, torch.from_numpy(field.mesh.cells))
    stress = _stress(problem, cells, moved, excess)
    value = cells.interpolated(cells.to_nodes(_von_mises(stress)), torch.from_numpy(cell), torch.from_numpy(point))
    scalar = (torch.from_numpy(gradient) * value).sum()
    (by_moved,) = torch.autograd.grad(scalar, moved, retain_graph=True)
    multiplier = torch.from_numpy(problem.equilibrium.solve(by_moved.numpy())[0])
    scalar = scalar - _work(problem, cells, points, stress, moved.detach(), multiplier)
    (by_excess,) = torch.autograd.grad(scalar, excess, retain_graph=True)
    multipliers = problem.cooling.adjoint(by_excess.numpy(), len(problem.ambient))
    scalar = scalar - _heat(problem, cells, points, multipliers)
    return torch.autograd.grad(scalar, points)[0].numpy()


def by_surface(problem: Problem, by_nodes: np.ndarray) -> np.ndarray:
    """The same derivative for a surface that takes the nodes inside along, ``[N,3]``; zero inside.

    They follow harmonically. A surface that moves alone squeezes the outermost cells, whose shape has a part in the
    error of the field; the derivative is the smoother, and the nearer to that of the continuum, the less it sees of it.

    Raises:
        SolveError: a solve did not converge.
    """
    stiffness = problem.elements.stiffness()
    inner = np.ones(problem.elements.nodes, dtype=bool)
    inner[problem.elements.boundary] = False
    result = np.where(inner[:, None], 0.0, by_nodes)
    if inner.any():
        rows = stiffness[inner]
        own, coupling = rows[:, inner], rows[:, ~inner].T
        preconditioner = jacobi(own)
        for axis in range(3):
            load = by_nodes[inner, axis]
            carried, _ = solve_spd(own, load, preconditioner, HARMONIC, what="the motion of the nodes inside")
            result[~inner, axis] -= coupling @ carried
    return result


class _Cells:
    """What :class:`genmf_mi.stress.fem.assembly.P1` knows of its cells, as functions of the nodes ``points [N,3]``."""

    def __init__(self, points: Tensor, cells: Tensor) -> None:
        self.cells, self.nodes = cells, len(points)
        corner = points[cells]
        self.first = corner[:, 0]
        edges = corner[:, 1:] - corner[:, :1]
        crossed = torch.stack(
            [torch.linalg.cross(edges[:, (i + 1) % 3], edges[:, (i + 2) % 3]) for i in range(3)], dim=1
        )
        six_volumes = (edges[:, 0] * crossed[:, 0]).sum(dim=1)
        self.volumes = six_volumes / 6
        others = crossed / six_volumes[:, None, None]
        self.gradients = torch.cat([-others.sum(dim=1, keepdim=True), others], dim=1)

    def strain(self, moved: Tensor) -> Tensor:
        gradient = torch.einsum("tai,taj->tij", moved[self.cells], self.gradients)
        return (gradient + gradient.transpose(1, 2)) / 2

    def nodal(self, value: Tensor) -> Tensor:
        """A quarter of the integral of each cell's ``value [T]`` to each of its nodes, ``[N]``."""
        share = (self.volumes * value / 4)[:, None].expand(-1, 4)
        return torch.zeros(self.nodes, dtype=value.dtype).index_add(0, self.cells.reshape(-1), share.reshape(-1))

    def to_nodes(self, value: Tensor) -> Tensor:
        return self.nodal(value) / self.nodal(torch.ones_like(value))

    def interpolated(self, value: Tensor, cell: Tensor, point: Tensor) -> Tensor:
        """The piecewise linear field ``value [N]`` at each ``point [M,3]``, which is in ``cell [M]``."""
        corner = value[self.cells[cell]]
        slope = torch.einsum("ma,mai->mi", corner, self.gradients[cell])
        return corner[:, 0] + (slope * (point - self.first[cell])).sum(dim=1)


def _stress(problem: Problem, cells: _Cells, moved: Tensor, excess: Tensor) -> Tensor:
    """As :func:`genmf_mi.stress.fem.elasticity.stress`."""
    lam, mu = problem.material.lame
    strain = cells.strain(moved)
    pressure = lam * _trace(strain) - problem.material.thermal_modulus * excess[cells.cells].mean(dim=1)
    return 2 * mu * strain + pressure[:, None, None] * torch.eye(3, dtype=strain.dtype)


def _von_mises(stress: Tensor) -> Tensor:
    deviator = stress - _trace(stress)[:, None, None] / 3 * torch.eye(3, dtype=stress.dtype)
    return (1.5 * deviator.square().sum(dim=(1, 2))).clamp_min(1e-20).sqrt()


def _trace(tensor: Tensor) -> Tensor:
    return tensor.diagonal(dim1=1, dim2=2).sum(dim=1)


def _work(problem: Problem, cells: _Cells, points: Tensor, stress: Tensor, moved: Tensor, multiplier: Tensor) -> Tensor:
    """λ·r of the equilibrium: the work of the stress and of the springs over the multiplier as a displacement."""
    inner = (cells.volumes * (stress * cells.strain(multiplier)).sum(dim=(1, 2))).sum()
    stuff, protocol = problem.material, problem.protocol
    volume = cells.nodal(torch.ones_like(cells.volumes))
    spring = soft_clamp(points[:, 2], volume, stuff.youngs_modulus_mpa, protocol.clamp_fraction)
    return inner + (spring * (moved * multiplier).sum(dim=1)).sum()


def _heat(problem: Problem, cells: _Cells, points: Tensor, multipliers: np.ndarray) -> Tensor:
    """Σ μ_k·r_k of the heat equation. It is linear in what depends on the nodes, so the steps are summed first."""
    index, faces = cells.cells.numpy(), problem.elements.boundary
    stored, led, lost = np.zeros(len(index)), np.zeros((len(index), 4, 4)), np.zeros(len(faces))
    for k, (multiplier, ambient) in enumerate(zip(multipliers, problem.ambient, strict=True)):
        before, after = problem.excess[k], problem.excess[k + 1]
        stored += _mass(multiplier[index], (after - before)[index])
        led += np.einsum("ta,tb->tab", multiplier[index], after[index])
        lost += _mass(multiplier[faces], (after - ambient)[faces])
    stuff, protocol = problem.material, problem.protocol
    a, b, c = (points[torch.from_numpy(faces[:, i])] for i in range(3))
    areas = torch.linalg.cross(b - a, c - a).norm(dim=1) / 2
    slopes = torch.einsum("tab,tai,tbi->t", torch.from_numpy(led), cells.gradients, cells.gradients)
    capacity = stuff.volumetric_heat_j_mm3k / protocol.step_s
    per_volume = capacity * torch.from_numpy(stored) + stuff.conductivity_w_mmk * slopes
    return (cells.volumes * per_volume).sum() + protocol.heat_transfer_coefficient_w_mm2k * (
        areas * torch.from_numpy(lost)
    ).sum()


def _mass(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """∫ u v over each simplex by its volume, for linear u and v given at its corners, ``[S,C]`` each."""
    corners = first.shape[1]
    return ((first * second).sum(axis=1) + first.sum(axis=1) * second.sum(axis=1)) / (corners * (corners + 1))

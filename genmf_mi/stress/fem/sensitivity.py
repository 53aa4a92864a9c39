"""The derivative of von Mises stress with respect to the shape: the adjoint of
:class:`genmf_mi.stress.fem.problem.Problem`.

A scalar J(x, u, T) of the nodes x, the displacement u and the temperatures T_k, with residuals r = K(x) u − f(x, T)
and r_k = A(x) T_k − C(x) T_{k−1} − b(x) T_amb,k, has the derivative

    dJ/dx = ∂J/∂x − λ·∂r/∂x − Σ μ_k·∂r_k/∂x    with    K λ = ∂J/∂u,    A μ_k = C μ_{k+1} + [k is last] (∂J/∂T − λ·∂r/∂T)

All matrices are symmetric, so the systems of the forward solve are solved once more. What is differentiated with
respect to x is a sum over cells with everything else constant, which torch does.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from genmf_mi.stress.fem import elasticity
from genmf_mi.stress.fem.linear import jacobi, solve_spd
from genmf_mi.stress.fem.problem import Field, Problem
from genmf_mi.stress.fem.shape_functions import ShapeFunctions, triangle_areas

HARMONIC = 1e-6
"""Relative residual of the harmonic motion of the inner nodes."""


Scalar = Callable[[ShapeFunctions[Tensor], Tensor], Tensor]
"""From the elements and von Mises in MPa in each of their cells ``[T]`` to a scalar, differentiable in both."""


@torch.enable_grad()
def nodal_gradient(problem: Problem, field: Field, scalar: Scalar) -> np.ndarray:
    """Derivative of a scalar of the von Mises field with respect to the nodes of the mesh, ``[N,3]`` per mm.

    The clamp follows the lowest node, and its height that of the highest above it.

    Args:
        problem: solved; field: its solution.

    Raises:
        SolveError: a solve did not converge.
    """
    points, displacement, temperature_rise = (
        torch.tensor(array, requires_grad=True)
        for array in (field.mesh.points, field.displacement, problem.temperature_rise[-1])
    )
    elements = ShapeFunctions(points, torch.from_numpy(field.mesh.cells))
    stress = elasticity.stress(elements, problem.material, displacement, temperature_rise)
    value = scalar(elements, elasticity.von_mises(stress))
    (by_displacement,) = torch.autograd.grad(value, displacement, retain_graph=True)
    multiplier = torch.from_numpy(problem.equilibrium.solve(by_displacement.numpy())[0])
    value = value - _elastic_residual(problem, elements, stress, displacement.detach(), multiplier)
    (by_temperature,) = torch.autograd.grad(value, temperature_rise, retain_graph=True)
    multipliers = problem.cooling.adjoint(by_temperature.numpy(), len(problem.ambient))
    value = value - _heat_residual(problem, elements, multipliers)
    return torch.autograd.grad(value, points)[0].numpy()


def read_at(cell: np.ndarray, point: np.ndarray, gradient: np.ndarray) -> Scalar:
    """A scalar that reads the field at fixed points.

    Args:
        cell, point: ``[M]`` and ``[M,3]`` in mm.
        gradient: of the scalar with respect to von Mises in MPa at these points, ``[M]``.
    """

    def scalar(elements: ShapeFunctions[Tensor], von_mises: Tensor) -> Tensor:
        weight = elements.barycentric(torch.from_numpy(cell), torch.from_numpy(point))
        at_corners = elements.to_nodes(von_mises)[elements.cells[torch.from_numpy(cell)]]
        return (torch.from_numpy(gradient) * (at_corners * weight).sum(dim=1)).sum()

    return scalar


def surface_gradient(problem: Problem, gradient: np.ndarray) -> np.ndarray:
    """The same derivative for a surface that takes the inner nodes along, ``[N,3]``; zero at these.

    They follow harmonically: each coordinate of their motion solves Laplace's equation, whose transpose is applied to
    ``gradient [N,3]``, that of :func:`nodal_gradient`. A surface that moves alone squeezes the outermost cells, whose
    shape has a part in the discretisation error; the less of that the derivative contains, the smoother it is and the
    nearer to that of the continuum.

    Raises:
        SolveError: a solve did not converge.
    """
    stiffness = problem.elements.stiffness()
    inner = np.ones(problem.elements.nodes, dtype=bool)
    inner[problem.elements.boundary] = False
    result = np.where(inner[:, None], 0.0, gradient)
    if inner.any():
        rows = stiffness[inner]
        own, coupling = rows[:, inner], rows[:, ~inner].T
        preconditioner = jacobi(own)
        for axis in range(3):
            load = gradient[inner, axis]
            adjoint, _ = solve_spd(own, load, preconditioner, HARMONIC, what="the motion of the inner nodes")
            result[~inner, axis] -= coupling @ adjoint
    return result


def _elastic_residual(
    problem: Problem, elements: ShapeFunctions[Tensor], stress: Tensor, displacement: Tensor, multiplier: Tensor
) -> Tensor:
    """λ·r of the equilibrium: the work of the stress and of the springs over the multiplier as a displacement."""
    inner = (elements.volumes * (stress * elements.strain(multiplier)).sum(dim=(1, 2))).sum()
    modulus, fraction = problem.material.youngs_modulus_mpa, problem.protocol.clamp_fraction
    spring = elasticity.soft_clamp(elements.points[:, 2], elements.nodal_volume(), modulus, fraction)
    return inner + (spring * (displacement * multiplier).sum(dim=1)).sum()


def _heat_residual(problem: Problem, elements: ShapeFunctions[Tensor], multipliers: np.ndarray) -> Tensor:
    """Σ μ_k·r_k of the heat equation. It is linear in what depends on the nodes, so the time steps are summed first."""
    cells, faces = elements.cells.numpy(), problem.elements.boundary
    stored, conducted, convected = np.zeros(len(cells)), np.zeros((len(cells), 4, 4)), np.zeros(len(faces))
    for k, (multiplier, ambient) in enumerate(zip(multipliers, problem.ambient, strict=True)):
        before, after = problem.temperature_rise[k], problem.temperature_rise[k + 1]
        stored += _mean_product(multiplier[cells], (after - before)[cells])
        conducted += np.einsum("ta,tb->tab", multiplier[cells], after[cells])
        convected += _mean_product(multiplier[faces], (after - ambient)[faces])
    material, protocol = problem.material, problem.protocol
    areas = triangle_areas(elements.points, torch.from_numpy(faces))
    slopes = torch.einsum("tab,tai,tbi->t", torch.from_numpy(conducted), elements.gradients, elements.gradients)
    capacity = material.volumetric_heat_j_mm3k / protocol.step_s
    per_volume = capacity * torch.from_numpy(stored) + material.conductivity_w_mmk * slopes
    per_area = protocol.heat_transfer_coefficient_w_mm2k * torch.from_numpy(convected)
    return (elements.volumes * per_volume).sum() + (areas * per_area).sum()


def _mean_product(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """∫ u v over each simplex by its volume, for linear u and v with these values at its corners, ``[S,C]`` each."""
    corners = first.shape[1]
    return ((first * second).sum(axis=1) + first.sum(axis=1) * second.sum(axis=1)) / (corners * (corners + 1))

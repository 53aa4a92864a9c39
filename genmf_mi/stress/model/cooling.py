"""How far a body has cooled when its stress is recorded: the load of the stress problem; coarse and differentiable.

Transient heat conduction with a Robin boundary, as in :mod:`genmf_mi.stress.fem.heat`, by finite volumes on blocks of
samples that the body fills in part:

    V ∂c/∂t = ∇·(a ∇c) − (h / ρ c_p) S (c − c_amb(t)),    a = k / ρ c_p,    c(0) = 0

with the volume fraction V of a block and its surface per volume S. Conduction is the two-point flux between neighbours
(the seven-point stencil), advanced by RKL1 super-time-stepping (first-order Runge–Kutta–Legendre; Meyer, Balsara and
Aslam 2012): s stages are stable for steps up to s (s + 1) / 2 times that of the explicit Euler scheme. The surface loss
is split off and follows by backward Euler. In steps of two minutes the result is within about a kelvin of the finite
elements for parts of 100 mm of PLA, which is enough for a feature of the network. Where heat spreads faster the steps
are rather long: within two kelvin for PLA at 50 mm, four for PETG at 50 mm. That is for blocks of 2³ samples; with
blocks of 4³ a part of 100 mm comes out a tenth too cold.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from genmf_mi.stress.fem.materials import Material
from genmf_mi.stress.fem.protocol import Protocol

STEPS = 10
"""Steps of time."""
MIN_VOLUME_FRACTION = 0.02
"""Blocks of a smaller volume fraction count as air."""
MIN_HEAT_FRACTION = 0.3
"""Blocks of a smaller volume fraction hold as much heat as one of this: it keeps the number of stages small."""
AXES = (2, 3, 4)
"""Of x, y and z in a field ``[B,C,X,Y,Z]``."""


def relative_cooling(
    phi: Float[Tensor, "batch 1 x y z"],
    cell: float,
    block_size: int,
    cell_mm: float,
    material: Material,
    protocol: Protocol,
) -> Float[Tensor, "batch 1 x//{block_size} y//{block_size} z//{block_size}"]:
    """The dimensionless cooling c = (T₀ − T) / (T₀ − T_end) when the field is recorded.

    0 is as warm as at the start, 1 as cold as the air in the end.

    Args:
        phi: normalised units; the sides must be multiples of ``block_size``.
        cell: distance of the samples in those units, ``cell_mm`` in millimetres.
        block_size: samples along the side of a block.

    Returns:
        One value per block, 0 in the air.
    """
    volume_fraction, surface = _blocks(phi, cell, block_size)
    width = block_size * cell_mm
    diffusivity = material.conductivity_w_mmk / material.volumetric_heat_j_mm3k
    solid = volume_fraction > MIN_VOLUME_FRACTION
    inverse_volume = solid / volume_fraction.clamp_min(MIN_HEAT_FRACTION)
    # The larger fraction of the two: a block that is filled in part holds a piece of the wall, which touches its
    # neighbour well
    conductances = [
        diffusivity / width**2 * torch.maximum(*_pair(volume_fraction, axis)) * torch.logical_and(*_pair(solid, axis))
        for axis in AXES
    ]
    heat_transfer = protocol.heat_transfer_coefficient_w_mm2k / material.volumetric_heat_j_mm3k
    loss = heat_transfer / cell_mm * surface * inverse_volume
    step = protocol.record_s / STEPS
    explicit_step = MIN_HEAT_FRACTION * width**2 / (6 * diffusivity)
    stages = 1
    while stages * (stages + 1) / 2 * explicit_step < step:
        stages += 1

    def advance(cooling: Tensor, ambient: float, inverse_volume: Tensor, loss: Tensor, *conductances: Tensor) -> Tensor:
        share = 2 / (stages * (stages + 1)) * step
        previous, current = cooling, cooling + share * _conduction(cooling, inverse_volume, conductances)
        for j in range(2, stages + 1):
            advanced = current + share * _conduction(current, inverse_volume, conductances)
            previous, current = current, (2 * j - 1) / j * advanced + (1 - j) / j * previous
        return (current + step * loss * ambient) / (1 + step * loss)

    cooling = torch.zeros_like(volume_fraction)
    for index in range(1, STEPS + 1):
        ambient = 1.0 if protocol.ramp_s == 0 else min(1.0, index * step / protocol.ramp_s)
        arguments = (cooling, ambient, inverse_volume, loss, *conductances)
        if cooling.requires_grad or loss.requires_grad:
            # Memory for one step instead of all
            cooling = checkpoint(advance, *arguments, use_reentrant=False)
            assert isinstance(cooling, Tensor)  # checkpoint has no types
        else:
            cooling = advance(*arguments)
    return cooling * solid


def _blocks(phi: Tensor, cell: float, block_size: int) -> tuple[Tensor, Tensor]:
    """The volume fraction of each block, and its surface per volume in 1/cells.

    The share of each sample's cell that is inside falls from 1 to 0 over one cell across the surface; the length of its
    gradient by central differences, whose integral across the surface is 1, is the density of the surface.
    """
    inside = (0.5 - phi / cell).clamp(0, 1)
    squared = torch.full_like(inside, 1e-12)
    for axis in AXES:
        size = inside.shape[axis]
        padded = F.pad(inside, _both_sides(axis), mode="replicate")
        squared = squared + ((padded.narrow(axis, 2, size) - padded.narrow(axis, 0, size)) / 2).square()
    return F.avg_pool3d(inside, block_size), F.avg_pool3d(squared.sqrt(), block_size)


def _pair(field: Tensor, axis: int) -> tuple[Tensor, Tensor]:
    """The two blocks at each face between blocks along an axis."""
    size = field.shape[axis] - 1
    return field.narrow(axis, 0, size), field.narrow(axis, 1, size)


def _both_sides(axis: int) -> list[int]:
    """One sample at each end of an axis, for :func:`torch.nn.functional.pad`, which counts from the last axis."""
    padding = [0] * 6
    first = 2 * (AXES[-1] - axis)
    padding[first : first + 2] = 1, 1
    return padding


def _conduction(cooling: Tensor, inverse_volume: Tensor, conductances: tuple[Tensor, ...]) -> Tensor:
    """∂c/∂t by conduction: what flows in through the faces of each block."""
    inflow = torch.zeros_like(cooling)
    for axis, conductance in zip(AXES, conductances, strict=True):
        first, second = _pair(cooling, axis)
        flow = conductance * (second - first)
        # Each view is made after the last change, as autograd wants it
        inflow.narrow(axis, 0, flow.shape[axis]).add_(flow)
        inflow.narrow(axis, 1, flow.shape[axis]).sub_(flow)
    return inverse_volume * inflow

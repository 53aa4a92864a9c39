"""How far a body has cooled when its stress is read: the load of the stress problem, on a coarse grid, differentiable.

A finite-volume scheme on blocks of samples that the body fills in part, in steps of two minutes. It is within about
a kelvin of the finite elements, which is enough for a feature of the network.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from genmf_mi.stress.fem.materials import Material
from genmf_mi.stress.fem.protocol import Protocol

STEPS = 10
"""Steps of time."""
LEAST_FILLED = 0.02
"""Blocks that are filled less count as air."""
LEAST_HEAT = 0.3
"""Blocks that are filled less hold as much heat as one filled so far: it keeps the number of stages small."""


def cooled(phi: Tensor, cell: float, side: int, cell_mm: float, material: Material, protocol: Protocol) -> Tensor:
    """(T₀ − T) / (T₀ − T_end) when the field is read: 0 where the body is as warm as at the start, 1 as cold as the air
    in the end.

    Args:
        phi: ``[B,1,X,Y,Z]``, normalised units; the sides must be multiples of ``side``.
        cell: distance of the samples in those units, ``cell_mm`` in millimetres.
        side: samples along the side of a block.

    Returns:
        ``[B,1,X/side,Y/side,Z/side]``, 0 in the air.
    """
    filled, area = _blocks(phi, cell, side)
    width = side * cell_mm
    diffusivity = material.conductivity_w_mmk / material.volumetric_heat_j_mm3k
    active = filled > LEAST_FILLED
    inverse = active / filled.clamp_min(LEAST_HEAT)
    # A block that is filled in part holds a piece of the wall, and that touches its neighbour well
    links = [
        diffusivity / width**2 * torch.maximum(*_pair(filled, axis)) * torch.logical_and(*_pair(active, axis))
        for axis in (2, 3, 4)
    ]
    loss = protocol.heat_transfer_coefficient_w_mm2k / material.volumetric_heat_j_mm3k / cell_mm * area * inverse
    step = protocol.record_s / STEPS
    # Stages whose stability grows with their square (Legendre, Meyer et al. 2012)
    stages = 1
    while stages * (stages + 1) / 2 * LEAST_HEAT * width**2 / (6 * diffusivity) < step:
        stages += 1

    def advance(cold: Tensor, ambient: float, inverse: Tensor, loss: Tensor, *links: Tensor) -> Tensor:
        first = 2 / (stages * (stages + 1))
        before, here = cold, cold + first * step * _diffused(cold, inverse, links)
        for j in range(2, stages + 1):
            ahead = (2 * j - 1) / j * (here + first * step * _diffused(here, inverse, links))
            before, here = here, ahead + (1 - j) / j * before
        return (here + step * loss * ambient) / (1 + step * loss)

    cold = torch.zeros_like(filled)
    for index in range(1, STEPS + 1):
        ambient = 1.0 if protocol.ramp_s == 0 else min(1.0, index * step / protocol.ramp_s)
        if cold.requires_grad or loss.requires_grad:
            # Memory for one step instead of all
            cold = checkpoint(advance, cold, ambient, inverse, loss, *links, use_reentrant=False)
        else:
            cold = advance(cold, ambient, inverse, loss, *links)
    return cold * active


def _blocks(phi: Tensor, cell: float, side: int) -> tuple[Tensor, Tensor]:
    """How full each block is, and its surface per volume, in 1/cells."""
    filled = (0.5 - phi / cell).clamp(0, 1)
    slopes = []
    for axis in (2, 3, 4):
        padded = F.pad(filled, [1 if 2 * (4 - axis) == i // 2 * 2 else 0 for i in range(6)], mode="replicate")
        size = filled.shape[axis]
        slopes.append((padded.narrow(axis, 2, size) - padded.narrow(axis, 0, size)) / 2)
    area = (sum(slope.square() for slope in slopes) + 1e-12).sqrt()
    return F.avg_pool3d(filled, side), F.avg_pool3d(area, side)


def _pair(field: Tensor, axis: int) -> tuple[Tensor, Tensor]:
    size = field.shape[axis] - 1
    return field.narrow(axis, 0, size), field.narrow(axis, 1, size)


def _diffused(cold: Tensor, inverse: Tensor, links: tuple[Tensor, ...]) -> Tensor:
    """∂/∂t of ``cold`` by conduction."""
    total = 0
    for axis, link in zip((2, 3, 4), links, strict=True):
        here, there = _pair(cold, axis)
        flow = link * (there - here)
        ahead = [0] * 6
        ahead[2 * (4 - axis) + 1] = 1
        behind = ahead[:]
        behind[2 * (4 - axis)], behind[2 * (4 - axis) + 1] = 1, 0
        total = total + F.pad(flow, ahead) - F.pad(flow, behind)
    return inverse * total

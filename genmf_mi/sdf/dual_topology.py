"""Dual marching cubes without positions: the cubes, edges and patches of a surface, and their connectivity.

The patches come from :mod:`genmf_mi.sdf.cube_cases`; every grid edge that crosses the surface gives one quad.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import torch
from torch import Tensor

from genmf_mi.sdf import cube_cases


class Topology(NamedTuple):
    """All that follows from the signs of Φ alone.

    S cubes intersect the surface, which crosses E grid edges and has D dual vertices. The four cubes around an edge are
    in order, so that the quad of their vertices is oriented outwards. An edge on the border of the grid has fewer; for
    those that are missing ``vertex`` is D, and the other fields are those of an arbitrary cube.

    inside: bool ``[m,m,m]``.
    cubes: ``[S]``, indices into the n³ cubes.
    owner: ``[D]``, the row in ``cubes`` of every dual vertex.
    ends: ``[E,2]``, the samples at the lower and upper end of an edge.
    vertex: ``[E,4]``, the dual vertices around an edge.
    edge: ``[E,4]``, the edge within each cube as an index into ``beta [S,12]``, flattened.
    corners: ``[E,4,2]``, its ends as indices into ``alpha [S,8]``, flattened.
    quads: ``[Q,4]``, the rows of ``vertex`` with all four.
    """

    inside: Tensor
    cubes: Tensor
    owner: Tensor
    ends: Tensor
    vertex: Tensor
    edge: Tensor
    corners: Tensor
    quads: Tensor


def topology(inside: Tensor) -> Topology:
    """Which cubes, edges and patches the surface has; ``inside`` is bool ``[m,m,m]``."""
    n, device = inside.shape[0] - 1, inside.device
    patch, doubled, edge_at, edge_ends = _tables(device)
    case = _cases(inside)
    cubes = ((case > 0) & (case < 255)).nonzero().squeeze(1)
    row = case[cubes].long()
    row = row + 256 * _inverted(case, cubes, doubled[row], doubled, n)

    count = patch[row].amax(dim=1) + 1
    first = count.cumsum(0) - count
    total = int(count.sum())
    owner = torch.arange(len(cubes), device=device).repeat_interleave(count)
    slot = torch.full((n**3,), -1, device=device)
    slot[cubes] = torch.arange(len(cubes), device=device)

    base, axis = _crossed(inside)
    step = torch.tensor([(n + 1) ** 2, n + 1, 1], device=device)
    low = (base * step).sum(dim=1)
    ends = torch.stack([low, low + step[axis]], dim=1)
    upwards = inside.reshape(-1)[low]  # from the inside along the axis

    # The cubes counter-clockwise about the axis: offset of the edge from their corner along the next two axes.
    turn = torch.tensor([[0, 0], [1, 0], [1, 1], [0, 1]], device=device)
    turn = torch.where(upwards[:, None, None], turn, turn.flip(0))
    place = base[:, None, :].repeat(1, 4, 1)
    for k in (1, 2):
        place.scatter_add_(2, ((axis + k) % 3)[:, None, None].expand(-1, 4, 1), -turn[:, :, k - 1 : k])
    exists = ((place >= 0) & (place < n)).all(dim=2)
    cube = slot[(place * torch.tensor([n * n, n, 1], device=device)).sum(dim=2).clamp(0, n**3 - 1)].clamp_min(0)
    edge = edge_at[axis[:, None], turn[:, :, 0], turn[:, :, 1]]
    vertex = torch.where(exists, first[cube] + patch[row[cube], edge], total)
    return Topology(
        inside=inside,
        cubes=cubes,
        owner=owner,
        ends=ends,
        vertex=vertex,
        edge=cube * 12 + edge,
        corners=cube[:, :, None] * 8 + edge_ends[edge],
        quads=vertex[exists.all(dim=1)],
    )


def _cases(inside: Tensor) -> Tensor:
    """The case of every cube, uint8 ``[n³]``."""
    bits, n = inside.to(torch.uint8), inside.shape[0] - 1
    case = torch.zeros(n, n, n, dtype=torch.uint8, device=inside.device)
    for corner in range(8):
        x, y, z = corner & 1, corner >> 1 & 1, corner >> 2
        case |= bits[x : x + n, y : y + n, z : z + n] << corner
    return case.reshape(-1)


def _inverted(case: Tensor, cubes: Tensor, face: Tensor, doubled: Tensor, n: int) -> Tensor:
    """Which cubes join the other pairs on their face, bool ``[S]``: a patch of the cube beyond passes it twice, too."""
    axis, side = face.clamp_min(0) // 2, face.clamp_min(0) % 2
    stride = torch.tensor([n * n, n, 1], device=case.device)[axis]
    along = cubes // stride % n + 2 * side - 1
    beyond = (cubes + (2 * side - 1) * stride).clamp(0, n**3 - 1)
    return (face >= 0) & (along >= 0) & (along < n) & (doubled[case[beyond].long()] == (face ^ 1))


def _crossed(inside: Tensor) -> tuple[Tensor, Tensor]:
    """The lower end ``[E,3]`` and the axis ``[E]`` of every edge whose ends differ."""
    n = inside.shape[0] - 1
    crossed = [(inside.narrow(axis, 0, n) ^ inside.narrow(axis, 1, n)).nonzero() for axis in range(3)]
    axis = torch.arange(3, device=inside.device).repeat_interleave(
        torch.tensor([len(rows) for rows in crossed], device=inside.device)
    )
    return torch.cat(crossed), axis


@cache
def _tables(device: torch.device) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """``[512,12]`` patches, ``[256]`` doubled faces, ``[3,2,2]`` edge at a place, ``[12,2]`` corners of an edge."""
    patch, doubled = cube_cases.tables()
    edge_at = [[[cube_cases.edge_at(axis, u, v) for v in (0, 1)] for u in (0, 1)] for axis in range(3)]
    return (
        torch.as_tensor(patch, device=device),
        torch.as_tensor(doubled, device=device),
        torch.as_tensor(edge_at, device=device),
        torch.as_tensor(cube_cases.EDGES, device=device),
    )

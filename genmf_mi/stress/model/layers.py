"""The parts of the stress network (GenMF paper, section "Network Design").

Fields are ``[B,C,X,Y,Z]`` with y up. Sides may be odd: a max-pooling drops the last plane of an odd side, and
:class:`Up` repeats the last plane of what comes back.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from genmf_mi.core.frame import HALF_EXTENT
from genmf_mi.sdf.redistance import REACH_CELLS
from genmf_mi.stress.fem.elasticity import clamp_profile
from genmf_mi.stress.fem.materials import material
from genmf_mi.stress.fem.simulation import Settings
from genmf_mi.stress.model.cooling import cooled

SMALL = 512
"""Samples below which a field is convolved in float32 always."""


class GeometricGradient(nn.Module):
    """Φ, its normalised gradient and its Laplacian, ``[B,1,X,Y,Z]`` to ``[B,5,X,Y,Z]``.

    The derivatives are central differences, each averaged over the other two axes with the weights (1, 2, 1)/4: that
    takes two thirds off the noise of Φ as it is stored. The Laplacian is per cell (times ``cell``), so that a ridge
    gives about -1 on any grid. The gradient is divided by the root of its square plus :data:`SOFT`², as it vanishes
    where distances to two walls are equal.

    Args:
        cell: side of a grid cell in the units of Φ.
    """

    SOFT = 0.1

    def __init__(self, cell: float) -> None:
        super().__init__()
        self.cell = cell

    def forward(self, phi: Tensor) -> Tensor:
        """Φ ``[B,1,X,Y,Z]``, float32."""
        phi = phi.clamp(max=REACH_CELLS * self.cell)
        padded = F.pad(phi, (1,) * 6, mode="replicate")
        blurred = [_smoothed(padded, axis) for axis in (2, 3, 4)]
        across = [_smoothed(blurred[1], 4), _smoothed(blurred[0], 4), _smoothed(blurred[0], 3)]
        gradient, laplacian = [], 0
        for axis, field in enumerate(across, start=2):
            before, here, after = _neighbours(field, axis)
            gradient.append((after - before) / (2 * self.cell))
            laplacian = laplacian + (after - 2 * here + before) / self.cell
        gradient = torch.cat(gradient, dim=1)
        length = (gradient.square().sum(dim=1, keepdim=True) + self.SOFT**2).sqrt()
        return torch.cat([phi, gradient / length, laplacian], dim=1)


class Physics(nn.Module):
    """What loads the body and what holds it, Φ ``[B,1,X,Y,Z]`` to ``[B,3,X/side,Y/side,Z/side]``.

    How far the body has cooled (:func:`genmf_mi.stress.model.cooling.cooled`), the profile of the soft clamp at the base
    (:func:`genmf_mi.stress.fem.elasticity.clamp_profile`), and the height above the bed in the units of Φ. Base and top
    are those of the lowest and the highest sample inside, without derivatives.
    """

    CHANNELS = 3

    def __init__(self, cell: float, side: int) -> None:
        super().__init__()
        self.cell, self.side = cell, side

    def forward(self, phi: Tensor, settings: Settings) -> Tensor:
        """Φ float32, its sides multiples of ``side``; ``settings``: size, material and protocol of the part."""
        with torch.autocast(phi.device.type, enabled=False):
            cell_mm = self.cell * settings.size_mm / (2 * HALF_EXTENT)
            cold = cooled(phi, self.cell, self.side, cell_mm, material(settings.material), settings.protocol)
        inside = (phi <= 0).any(dim=4).any(dim=2)[:, 0]
        rows = torch.arange(inside.shape[1], device=phi.device)
        # Half a cell below the lowest sample inside, as the surface is somewhere between it and the next
        base = torch.where(inside, rows, len(rows)).amin(dim=1, keepdim=True) - 0.5
        extent = torch.where(inside, rows, -1).amax(dim=1, keepdim=True) + 0.5 - base
        height = (rows - base).to(phi.dtype)
        profile = clamp_profile(height / extent.clamp_min(1), settings.protocol.clamp_fraction)
        columns = torch.stack([profile * (height > 0), self.cell * height], dim=1)[:, :, None, :, None]
        columns = F.avg_pool3d(columns, (1, self.side, 1), (1, self.side, 1))
        return torch.cat([cold, columns.expand(-1, -1, cold.shape[2], -1, cold.shape[4])], dim=1)


def _neighbours(field: Tensor, axis: int) -> list[Tensor]:
    """The field before, at and after each inner sample of an axis."""
    size = field.shape[axis] - 2
    return [field.narrow(axis, start, size) for start in range(3)]


def _smoothed(field: Tensor, axis: int) -> Tensor:
    before, here, after = _neighbours(field, axis)
    return (before + after) / 4 + here / 2


def space_to_depth(field: Tensor, side: int) -> Tensor:
    """Space to depth: ``[B,C,X,Y,Z]`` to ``[B,C·side³,X/side,Y/side,Z/side]``; the sides must be multiples."""
    b, c, x, y, z = field.shape
    field = field.reshape(b, c, x // side, side, y // side, side, z // side, side)
    return field.permute(0, 1, 3, 5, 7, 2, 4, 6).reshape(b, c * side**3, x // side, y // side, z // side)


def depth_to_space(blocks: Tensor, side: int) -> Tensor:
    """Depth to space, the inverse of :func:`space_to_depth`."""
    b, c, x, y, z = blocks.shape
    blocks = blocks.reshape(b, c // side**3, side, side, side, x, y, z)
    return blocks.permute(0, 1, 5, 2, 6, 3, 7, 4).reshape(b, c // side**3, x * side, y * side, z * side)


class Res3DBlock(nn.Module):
    """x ↦ ReLU(F(x) + identity(x)), F being two 3×3×3 convolutions with instance normalisation and a ReLU between.

    The identity is a 1×1×1 convolution where the number of channels changes.
    """

    def __init__(self, channels: int, out: int) -> None:
        super().__init__()
        self.first, self.first_norm = (
            nn.Conv3d(channels, out, 3, padding=1, bias=False),
            nn.InstanceNorm3d(out, affine=True),
        )
        self.second, self.second_norm = (
            nn.Conv3d(out, out, 3, padding=1, bias=False),
            nn.InstanceNorm3d(out, affine=True),
        )
        self.identity = nn.Conv3d(channels, out, 1) if channels != out else nn.Identity()

    def forward(self, x: Tensor) -> Tensor:
        kind = x.device.type
        if x[0, 0].numel() < SMALL and kind != "meta" and torch.is_autocast_enabled(kind):
            # On fields of a few samples oneDNN's bfloat16 gradient of a kernel was seen to be NaN, and is no faster
            with torch.autocast(kind, enabled=False):
                return self._forward(x.float())
        return self._forward(x)

    def _forward(self, x: Tensor) -> Tensor:
        inner = F.relu(self.first_norm(self.first(x)))
        return F.relu(self.second_norm(self.second(inner)) + self.identity(x))


class SqueezeExcitation(nn.Module):
    """Channels scaled by what their means say about one another (Hu et al. 2018)."""

    def __init__(self, channels: int, reduction: int = 8) -> None:
        super().__init__()
        self.squeeze = nn.Linear(channels, max(1, channels // reduction))
        self.excite = nn.Linear(max(1, channels // reduction), channels)

    def forward(self, x: Tensor) -> Tensor:
        scale = torch.sigmoid(self.excite(F.relu(self.squeeze(x.mean(dim=(2, 3, 4))))))
        return x * scale[:, :, None, None, None]


def with_global_descriptor(x: Tensor) -> Tensor:
    """z + AvgPool(z): the mean of every channel added to it everywhere."""
    return x + x.mean(dim=(2, 3, 4), keepdim=True)


class Up(nn.Module):
    """Twice the resolution by a transpose convolution, then a :class:`Res3DBlock` over that and the skip."""

    def __init__(self, channels: int, out: int) -> None:
        super().__init__()
        self.enlarge, self.block = nn.ConvTranspose3d(channels, out, 2, stride=2), Res3DBlock(2 * out, out)

    def forward(self, x: Tensor, skip: Tensor) -> Tensor:
        """x ``[B,C,x,y,z]`` and skip ``[B,out,X,Y,Z]`` with x = X // 2 and so on, to ``[B,out,X,Y,Z]``."""
        x = self.enlarge(x)
        missing = [wanted - there for wanted, there in zip(skip.shape[2:], x.shape[2:])]
        if any(missing):
            x = F.pad(x, (0, missing[2], 0, missing[1], 0, missing[0]), mode="replicate")
        return self.block(torch.cat([x, skip], dim=1))


class GeometryFusion(nn.Module):
    """Φ beside the decoded features, a 3×3×3 convolution over both, and a 1×1×1 convolution to the result."""

    def __init__(self, channels: int, side: int) -> None:
        super().__init__()
        self.side = side
        self.fuse = nn.Conv3d(channels + side**3, channels, 3, padding=1)
        self.out = nn.Conv3d(channels, side**3, 1)

    def forward(self, x: Tensor, phi: Tensor) -> Tensor:
        """x ``[B,C,X/s,Y/s,Z/s]`` and Φ ``[B,1,X,Y,Z]``, to ``[B,1,X,Y,Z]``."""
        fused = F.relu(self.fuse(torch.cat([x, space_to_depth(phi, self.side).to(x.dtype)], dim=1)))
        return depth_to_space(self.out(fused), self.side)

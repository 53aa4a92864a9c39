"""The parts of the stress network (GenMF paper, section "Network Design").

Fields are ``[B,C,X,Y,Z]`` with y up. Sides may be odd: a max-pooling drops the last plane of an odd side, and
:class:`UpBlock` repeats the last plane of what comes back.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from genmf_mi.core.frame import HALF_EXTENT
from genmf_mi.sdf.redistance import REACH_CELLS
from genmf_mi.stress.fem.elasticity import clamp_profile
from genmf_mi.stress.fem.materials import material
from genmf_mi.stress.fem.simulation import Settings
from genmf_mi.stress.model.cooling import relative_cooling

FLOAT32_BELOW = 32
"""Samples below which a field is always convolved in float32."""


class GeometricGradient(nn.Module):
    """Φ, its normalised gradient and its Laplacian.

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

    def forward(self, phi: Float[Tensor, "batch 1 x y z"]) -> Float[Tensor, "batch 5 x y z"]:
        """Φ, three components of the gradient, the Laplacian; Φ is float32."""
        phi = phi.clamp(max=REACH_CELLS * self.cell)
        padded = F.pad(phi, (1,) * 6, mode="replicate")
        smoothed = [_smoothed(padded, axis) for axis in (2, 3, 4)]
        across = [_smoothed(smoothed[1], 4), _smoothed(smoothed[0], 4), _smoothed(smoothed[0], 3)]
        components, laplacian = [], torch.zeros_like(phi)
        for axis, field in enumerate(across, start=2):
            previous, centre, following = _neighbours(field, axis)
            components.append((following - previous).div_(2 * self.cell))
            laplacian += (following + previous).sub_(centre, alpha=2).div_(self.cell)
        gradient = torch.cat(components, dim=1)
        length = (gradient.square().sum(dim=1, keepdim=True) + self.SOFT**2).sqrt()
        return torch.cat([phi, gradient / length, laplacian], dim=1)


class Physics(nn.Module):
    """What loads the body and what supports it, per block: three channels.

    How far the body has cooled (:func:`.cooling.relative_cooling`), the profile of the soft clamp at the base
    (:func:`genmf_mi.stress.fem.elasticity.clamp_profile`), and the height above the bed in the units of Φ. Base and top
    are those of the lowest and the highest sample inside, without derivatives.

    Args:
        cell: side of a grid cell in the units of Φ.
        block_size: samples along the side of a block.
    """

    CHANNELS = 3

    def __init__(self, cell: float, block_size: int) -> None:
        super().__init__()
        self.cell, self.block_size = cell, block_size

    def forward(
        self, phi: Float[Tensor, "batch 1 x y z"], settings: Settings
    ) -> Float[Tensor, "batch 3 x//{self.block_size} y//{self.block_size} z//{self.block_size}"]:
        """Φ is float32, its sides multiples of ``block_size``. settings: size, material and protocol of the part."""
        size = self.block_size
        cell_mm = self.cell * settings.size_mm / (2 * HALF_EXTENT)
        with torch.autocast(phi.device.type, enabled=False):
            cooling = relative_cooling(phi, self.cell, size, cell_mm, material(settings.material), settings.protocol)
        inside = (phi <= 0).any(dim=4).any(dim=2)[:, 0]
        rows = torch.arange(inside.shape[1], device=phi.device)
        # Half a cell below the lowest sample inside, as the surface is somewhere between it and the next
        base = torch.where(inside, rows, len(rows)).amin(dim=1, keepdim=True) - 0.5
        extent = torch.where(inside, rows, -1).amax(dim=1, keepdim=True) + 0.5 - base
        height = (rows - base).to(phi.dtype)
        profile = clamp_profile(height / extent.clamp_min(1), settings.protocol.clamp_fraction)
        columns = torch.stack([profile * (height > 0), self.cell * height], dim=1)[:, :, None, :, None]
        columns = F.avg_pool3d(columns, (1, size, 1), (1, size, 1))
        return torch.cat([cooling, columns.expand(-1, -1, cooling.shape[2], -1, cooling.shape[4])], dim=1)


def _neighbours(field: Tensor, axis: int) -> list[Tensor]:
    """The field before, at and after each inner sample of an axis."""
    size = field.shape[axis] - 2
    return [field.narrow(axis, start, size) for start in range(3)]


def _smoothed(field: Tensor, axis: int) -> Tensor:
    previous, centre, following = _neighbours(field, axis)
    return (previous + following).div_(4).add_(centre, alpha=0.5)


def space_to_depth(
    field: Float[Tensor, "batch c x y z"], block_size: int
) -> Float[Tensor, "batch c*{block_size}**3 x//{block_size} y//{block_size} z//{block_size}"]:
    """The samples of each block of ``block_size``³ as channels; the sides must be multiples of ``block_size``."""
    s, (b, c, x, y, z) = block_size, field.shape
    field = field.reshape(b, c, x // s, s, y // s, s, z // s, s)
    return field.permute(0, 1, 3, 5, 7, 2, 4, 6).reshape(b, c * s**3, x // s, y // s, z // s)


def depth_to_space(
    blocks: Float[Tensor, "batch c x y z"], block_size: int
) -> Float[Tensor, "batch c//{block_size}**3 x*{block_size} y*{block_size} z*{block_size}"]:
    """The inverse of :func:`space_to_depth`."""
    s, (b, c, x, y, z) = block_size, blocks.shape
    blocks = blocks.reshape(b, c // s**3, s, s, s, x, y, z)
    return blocks.permute(0, 1, 5, 2, 6, 3, 7, 4).reshape(b, c // s**3, x * s, y * s, z * s)


class InstanceNorm(nn.InstanceNorm3d):
    """Instance normalisation that keeps the channels last in memory.

    Of one sample it is a batch normalisation, which does; torch's instance normalisation rearranges the field twice.
    """

    def forward(self, input: Float[Tensor, "batch c x y z"]) -> Float[Tensor, "batch c x y z"]:
        if len(input) > 1:
            return super().forward(input)
        return F.batch_norm(input, None, None, self.weight, self.bias, training=True, momentum=0.0, eps=self.eps)


class Res3DBlock(nn.Module):
    """x ↦ ReLU(F(x) + identity(x)), F being two 3×3×3 convolutions with instance normalisation and a ReLU between.

    The identity is a 1×1×1 convolution where the number of channels changes.
    """

    def __init__(self, channels: int, out: int) -> None:
        super().__init__()
        self.first = nn.Conv3d(channels, out, 3, padding=1, bias=False)
        self.first_norm = InstanceNorm(out, affine=True)
        self.second = nn.Conv3d(out, out, 3, padding=1, bias=False)
        self.second_norm = InstanceNorm(out, affine=True)
        self.identity = nn.Conv3d(channels, out, 1) if channels != out else nn.Identity()

    def forward(self, x: Float[Tensor, "batch _ x y z"]) -> Float[Tensor, "batch _ x y z"]:
        kind = x.device.type
        if x[0, 0].numel() < FLOAT32_BELOW and kind != "meta" and torch.is_autocast_enabled(kind):
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

    def forward(self, x: Float[Tensor, "batch c x y z"]) -> Float[Tensor, "batch c x y z"]:
        scale = torch.sigmoid(self.excite(F.relu(self.squeeze(x.mean(dim=(2, 3, 4))))))
        return x * scale[:, :, None, None, None]


def with_global_descriptor(x: Float[Tensor, "batch c x y z"]) -> Float[Tensor, "batch c x y z"]:
    """z + AvgPool(z): the mean of every channel added to it everywhere."""
    return x + x.mean(dim=(2, 3, 4), keepdim=True)


class UpBlock(nn.Module):
    """Twice the resolution by a transpose convolution, then a :class:`Res3DBlock` over that and the skip."""

    def __init__(self, channels: int, out: int) -> None:
        super().__init__()
        self.enlarge, self.block = nn.ConvTranspose3d(channels, out, 2, stride=2), Res3DBlock(2 * out, out)

    def forward(
        self, x: Float[Tensor, "batch _ _ _ _"], skip: Float[Tensor, "batch c x y z"]
    ) -> Float[Tensor, "batch c x y z"]:
        """x at half the resolution of the skip, whose sides may be odd; result of the size of the skip."""
        x = self.enlarge(x)
        missing = [wanted - size for wanted, size in zip(skip.shape[2:], x.shape[2:])]
        if any(missing):
            x = F.pad(x, (0, missing[2], 0, missing[1], 0, missing[0]), mode="replicate")
        return self.block(torch.cat([x, skip], dim=1))


class GeometryFusion(nn.Module):
    """Φ beside the decoded features, a 3×3×3 convolution over both, and a 1×1×1 convolution to the result."""

    def __init__(self, channels: int, block_size: int) -> None:
        super().__init__()
        self.block_size = block_size
        self.fuse = nn.Conv3d(channels + block_size**3, channels, 3, padding=1)
        self.out = nn.Conv3d(channels, block_size**3, 1)

    def forward(
        self,
        x: Float[Tensor, "batch _ _ _ _"],
        phi: Float[Tensor, "batch 1 x y z"],
    ) -> Float[Tensor, "batch 1 x y z"]:
        """x: features of the blocks of ``block_size``³ samples that ``phi`` has."""
        fused = F.relu(self.fuse(torch.cat([x, space_to_depth(phi, self.block_size).to(x.dtype)], dim=1)))
        return depth_to_space(self.out(fused), self.block_size)

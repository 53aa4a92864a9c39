"""The network that tells the thermal stress of a body from its signed distance (GenMF paper, section 4).

    Φ ─ geometric gradient ─ blocks ─ Res3DBlock ─┬──────────── skip ────────────┬─ fusion with Φ ─ log(1 + σ/k)
        5 channels           of s³ samples        pool                          up
                                                  └─ Res3DBlock ─┬── … ──┬─ block ┘
                                                                 pool    up
                                                                 └─ Res3DBlock, SE, + mean ─┘

As in the paper but for four settings. The body's box is cut out of the grid first (:func:`window`), as nine samples in
ten are air. The compact network gathers blocks of 2³ samples into channels on the way in and spreads them out on the
way out, so that its convolutions run at half the resolution while it sees and tells every sample. And it is given
three more channels (:class:`~genmf_mi.stress.model.layers.Physics`): how far the body has cooled, how firmly the bed holds
it, and the height above the bed; and the stress on a coarse mesh (:mod:`genmf_mi.stress.fem.coarse`), to which it adds what
that mesh does not see. A network of the paper's size may learn all this from many shapes; a small one does not learn
it from a few hundred.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from genmf_mi.core.errors import ConfigError
from genmf_mi.stress.fem.coarse import EDGE_MM
from genmf_mi.stress.fem.simulation import Settings
from genmf_mi.stress.model.layers import (
    GeometricGradient,
    GeometryFusion,
    Physics,
    Res3DBlock,
    SqueezeExcitation,
    Up,
    space_to_depth,
    with_global_descriptor,
)

STRESS_SCALE_MPA = 3.0
"""k of the target log(1 + σ/k)."""
CORRECTION = 0.025
"""Unit of what is added to the coarse stress, in log(1 + σ/k): about twice its root mean square. Without it, the steps
of the optimiser are larger than what is to be learned, and in 250 of them nothing was."""
MARGIN = 4
"""Samples of air that :func:`window` leaves about the body: as far as Φ reaches outwards."""
MULTIPLE, LEAST = 16, 32
"""Sides of a window are multiples of the one, so that little is lost in the poolings, and at least the other, so that
something is left."""


@dataclass(frozen=True)
class Architecture:
    """Width and depth of the network.

    width: C, channels of the first level; level l has min(2ˡ, 8)·C.
    block_size: samples along the side of the blocks that become channels; 1 for none.
    poolings: max-poolings, each of which halves the resolution.
    physics: give the network what loads the body and what holds it, beside what it looks like.
    coarse_mm: edge of the coarse mesh whose stress is given to the network, and added to; 0 for none.
    grid: samples per axis of the grid [-1, 1]³ that Φ comes on.

    Raises:
        ConfigError: a number below 1, or a grid too small to be pooled that often.
    """

    width: int
    block_size: int = 1
    poolings: int = 4
    physics: bool = False
    coarse_mm: float = 0.0
    grid: int = 129

    def __post_init__(self) -> None:
        if min(self.width, self.block_size, self.poolings) < 1:
            raise ConfigError(f"width, block_size and poolings of a network must be at least 1: {self}.")
        if self.grid // self.least < 2:
            raise ConfigError(f"a grid of {self.grid} is too small for this network: {self}.")

    @property
    def least(self) -> int:
        """Samples that make one of the bottleneck, along an axis."""
        return self.block_size * 2**self.poolings

    @property
    def channels(self) -> list[int]:
        """Of each level, the bottleneck last."""
        return [self.width * min(2**level, 8) for level in range(self.poolings + 1)]


PRESETS = {"paper": Architecture(56), "compact": Architecture(24, block_size=2, physics=True, coarse_mm=EDGE_MM)}
"""``paper``: 46.7 M parameters, 3.4 TFLOP forward at 129³. ``compact``: 8.6 M, 92 GFLOP in the largest window and half
of that in the usual one; 1.2 GB with the backward pass."""


class StressNetwork(nn.Module):
    """Φ ``[B,1,X,Y,Z]`` in normalised units (negative inside, y up) to log(1 + σ/k) ``[B,1,X,Y,Z]``, k = 3 MPa.

    ``coarse``, for an architecture with ``coarse_mm``: von Mises on a coarse mesh in MPa, of the shape of Φ.
    ``settings``, for an architecture with ``physics``: size, material and protocol of the part.

    X, Y, Z may be odd; none may be below block_size · 2^poolings, and one must be twice that. The result means something
    where Φ ≤ 0. Φ is float32; under autocast the result has the lower precision.
    """

    def __init__(self, architecture: Architecture) -> None:
        super().__init__()
        self.architecture = architecture
        block_size, channels = architecture.block_size, architecture.channels
        self.geometry = GeometricGradient(2.0 / (architecture.grid - 1))
        self.physics = Physics(2.0 / (architecture.grid - 1), block_size) if architecture.physics else None
        entering = (6 if architecture.coarse_mm else 5) * block_size**3 + (
            Physics.CHANNELS if architecture.physics else 0
        )
        self.down = nn.ModuleList(map(Res3DBlock, [entering, *channels[:-1]], channels))
        self.recalibrate = SqueezeExcitation(channels[-1])
        self.up = nn.ModuleList(map(Up, channels[:0:-1], channels[-2::-1]))
        self.fusion = GeometryFusion(channels[0], block_size)
        if architecture.coarse_mm:  # it starts as what it is to add to
            for parameter in self.fusion.out.parameters():
                nn.init.zeros_(parameter)

    def forward(self, phi: Tensor, coarse: Tensor | None = None, settings: Settings | None = None) -> Tensor:
        """Raises :class:`ConfigError` for a field too small to be pooled, or without the coarse stress it asks for."""
        least = self.architecture.least
        if phi.dim() != 5 or phi.shape[1] != 1 or min(phi.shape[2:]) < least or max(phi.shape[2:]) < 2 * least:
            raise ConfigError(
                f"Φ must be [B,1,X,Y,Z] with sides of at least {least}, one of {2 * least}, not {list(phi.shape)}."
            )
        if bool(self.architecture.coarse_mm) != (coarse is not None):
            raise ConfigError("this network is given the stress on a coarse mesh, or is not, against its architecture.")
        shape, block_size = phi.shape[2:], self.architecture.block_size

        def padded(field: Tensor) -> Tensor:
            rest = [-n % block_size for n in shape]
            return F.pad(field, (0, rest[2], 0, rest[1], 0, rest[0]), mode="replicate")

        features = self.geometry(padded(phi))
        phi, blocks = features[:, :1], space_to_depth(features, block_size)
        if self.physics is not None:
            if settings is None:
                raise ConfigError("this network is given the size, the material and the protocol of the part.")
            blocks = torch.cat([blocks, self.physics(phi, settings)], dim=1)
        if coarse is not None:
            blocks = torch.cat([blocks, space_to_depth(padded(to_target(coarse)), block_size)], dim=1)
        x = self.down[0](blocks)
        skips = []
        for block in self.down[1:]:
            skips.append(x)
            x = block(F.max_pool3d(x, 2))
        x = with_global_descriptor(self.recalibrate(x))
        for up in self.up:
            x = up(x, skips.pop())
        told = self.fusion(x, phi)[:, :, : shape[0], : shape[1], : shape[2]]
        return told if coarse is None else CORRECTION * told + to_target(coarse)

    def settings(self) -> dict:
        return asdict(self.architecture)


def network(preset: str, grid: int = 129) -> StressNetwork:
    """An untrained network. Raises :class:`ConfigError` for an unknown preset."""
    if preset not in PRESETS:
        raise ConfigError(f"preset must be one of {', '.join(PRESETS)}, not {preset!r}.")
    return StressNetwork(Architecture(**{**asdict(PRESETS[preset]), "grid": grid}))


def to_target(stress: Tensor) -> Tensor:
    """log(1 + σ/k) of von Mises in MPa."""
    return torch.log1p(stress / STRESS_SCALE_MPA)


def to_stress(target: Tensor) -> Tensor:
    """Von Mises in MPa, the inverse of :func:`to_target`."""
    return STRESS_SCALE_MPA * torch.expm1(target)


def window(phi: Tensor) -> tuple[slice, slice, slice]:
    """The box about the samples with Φ ≤ 0 of ``phi [...,X,Y,Z]``: a margin all about, sides multiples of 16, from 32.

    What is added to make a multiple goes to the far end, so that the base always stands at one height in the window.
    An axis that has no room for that is taken whole.

    Raises:
        ConfigError: no sample is inside.
    """
    inside = (phi <= 0).reshape(-1, *phi.shape[-3:]).any(dim=0)
    slices = []
    for axis in range(3):
        size = inside.shape[axis]
        places = torch.nonzero(inside.transpose(0, axis).flatten(1).any(dim=1)).flatten().tolist()
        if not places:
            raise ConfigError("Φ is positive everywhere: there is no body in the grid.")
        low = max(places[0] - MARGIN, 0)
        length = -(-(places[-1] + 1 + MARGIN - low) // MULTIPLE) * MULTIPLE
        length = min(max(length, LEAST), size // MULTIPLE * MULTIPLE)
        low = min(low, size - length)
        slices.append(slice(low, low + length) if places[-1] < low + length else slice(0, size))
    return tuple(slices)

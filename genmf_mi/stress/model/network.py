"""The network that predicts the thermal stress of a body from its signed distance (GenMF paper, section 4).

    Φ ─ geometric gradient ─ blocks ─ Res3DBlock ─┬──────────── skip ────────────┬─ fusion with Φ ─ log(1 + σ/k)
        5 channels           of s³ samples        pool                          up
                                                  └─ Res3DBlock ─┬── … ──┬─ block ┘
                                                                 pool    up
                                                                 └─ Res3DBlock, SE, + mean ─┘

As in the paper but for four settings. The body's box is cropped from the grid first (:func:`crop_box`), as nine samples
in ten are air. The small networks gather blocks of 2³ or 4³ samples into channels on the way in and spread them out on
the way out (space to depth and back), so that their convolutions run at a half or a quarter of the resolution while
input and output have every sample. They have three more input channels
(:class:`~genmf_mi.stress.model.layers.Physics`): how far the body has cooled, how firmly the bed holds it, and the
height above the bed. And the compact network has the stress on a coarse mesh (:mod:`genmf_mi.stress.fem.coarse`), to
which it adds what that mesh does not resolve. A network of the paper's size may learn all this from many shapes; a
small one does not learn it from a few hundred.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Float
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
    UpBlock,
    space_to_depth,
    with_global_descriptor,
)

TARGET_SCALE_MPA = 3.0
"""k of the target log(1 + σ/k)."""
CORRECTION = 0.025
"""Unit of what is added to the coarse stress, in log(1 + σ/k): about twice its root mean square. Without it, the steps
of the optimiser are larger than what is to be learned, and in 250 of them nothing was."""
MEMORY_FORMAT = torch.channels_last_3d
"""Of fields and kernels: with the channels first, a step of the training takes a quarter more."""
CROP_MARGIN = 4
"""Samples of air that :func:`crop_box` leaves about the body: as far as Φ reaches outwards."""
CROP_MULTIPLE, CROP_MIN_SIDE = 16, 32
"""The sides of a crop are multiples of the one, so that little is lost in the poolings, and at least the other, so that
something is left after them."""

Box = tuple[slice, slice, slice]
"""A part of the grid: samples of x, y and z."""


@dataclass(frozen=True)
class Architecture:
    """Width and depth of the network.

    width: C, channels of the first level; level l has min(2ˡ, 8)·C.
    block_size: samples along the side of the blocks that become channels; 1 for none.
    poolings: max-poolings, each of which halves the resolution.
    physics: with the channels of :class:`~genmf_mi.stress.model.layers.Physics` beside those of the geometry.
    coarse_mm: edge of the coarse mesh whose stress the network corrects, for a longest side of 100 mm; 0 for none.
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
        if self.grid // self.downsampling < 2:
            raise ConfigError(f"a grid of {self.grid} is too small for this network: {self}.")

    @property
    def downsampling(self) -> int:
        """Samples along an axis that become one of the bottleneck."""
        return self.block_size * 2**self.poolings

    @property
    def channels(self) -> list[int]:
        """Of each level, the bottleneck last."""
        return [self.width * min(2**level, 8) for level in range(self.poolings + 1)]


PRESETS = {
    "paper": Architecture(56),
    "compact": Architecture(24, block_size=2, physics=True, coarse_mm=EDGE_MM),
    "direct": Architecture(32, block_size=4, poolings=3, physics=True),
}
"""``paper``: 46.7 M parameters, 3.4 TFLOP forward at 129³. ``compact``: 8.6 M, 92 GFLOP in the largest crop and half
of that in the usual one; 1.2 GB with the backward pass. ``direct``: 6.1 M, without the stress on a coarse mesh: its
input is Φ alone, as in the paper. It has to learn what the whole body does, for which many cheap steps at a quarter of
the resolution are worth more than few at half of it; see docs/model_card.md."""


class StressNetwork(nn.Module):
    """Φ in normalised units (negative inside, y up) to log(1 + σ/k) with k = 3 MPa, of one shape."""

    def __init__(self, architecture: Architecture) -> None:
        super().__init__()
        self.architecture = architecture
        block_size, channels = architecture.block_size, architecture.channels
        cell = 2.0 / (architecture.grid - 1)
        self.geometry = GeometricGradient(cell)
        self.physics = Physics(cell, block_size) if architecture.physics else None
        fields, per_block = 6 if architecture.coarse_mm else 5, Physics.CHANNELS if architecture.physics else 0
        inputs = fields * block_size**3 + per_block
        self.down = nn.ModuleList(map(Res3DBlock, [inputs, *channels[:-1]], channels))
        self.recalibrate = SqueezeExcitation(channels[-1])
        self.up = nn.ModuleList(map(UpBlock, channels[:0:-1], channels[-2::-1]))
        self.fusion = GeometryFusion(channels[0], block_size)
        if architecture.coarse_mm:  # without training it adds nothing to the coarse stress
            for parameter in self.fusion.out.parameters():
                nn.init.zeros_(parameter)
        self.to(memory_format=MEMORY_FORMAT)  # pyright: ignore[reportCallIssue]  (not in the types of torch)

    def forward(
        self,
        phi: Float[Tensor, "batch 1 x y z"],
        coarse: Float[Tensor, "batch 1 x y z"] | None = None,
        settings: Settings | None = None,
    ) -> Float[Tensor, "batch 1 x y z"]:
        """The target where Φ ≤ 0; elsewhere the result means nothing.

        Args:
            phi: float32. The sides may be odd; none may be below block_size · 2^poolings, and one must be twice that.
            coarse: von Mises on a coarse mesh in MPa, for an architecture with ``coarse_mm``.
            settings: size, material and protocol of the part, for an architecture with ``physics``.

        Returns:
            Under autocast of the lower precision.

        Raises:
            ConfigError: a field too small to be pooled; ``coarse`` or ``settings`` are missing, or ``coarse`` is given
                to an architecture without.
        """
        least = self.architecture.downsampling
        if min(phi.shape[2:]) < least or max(phi.shape[2:]) < 2 * least:
            raise ConfigError(
                f"Φ must be [B,1,X,Y,Z] with sides of at least {least}, one of {2 * least}, not {list(phi.shape)}."
            )
        if bool(self.architecture.coarse_mm) != (coarse is not None):
            needs = "needs" if self.architecture.coarse_mm else "does not take"
            raise ConfigError(f"this network {needs} the stress on a coarse mesh.")
        shape, block_size = phi.shape[2:], self.architecture.block_size

        def padded(field: Tensor) -> Tensor:
            rest = [-n % block_size for n in shape]
            return F.pad(field, (0, rest[2], 0, rest[1], 0, rest[0]), mode="replicate")

        features = self.geometry(padded(phi))
        padded_phi, inputs = features[:, :1], [space_to_depth(features, block_size)]
        if self.physics is not None:
            if settings is None:
                raise ConfigError("this network needs the size, the material and the protocol of the part.")
            inputs.append(self.physics(padded_phi, settings))
        if coarse is not None:
            inputs.append(space_to_depth(padded(to_target(coarse)), block_size))
        x = self.down[0](torch.cat(inputs, dim=1).contiguous(memory_format=MEMORY_FORMAT))
        skips = []
        for block in self.down[1:]:
            skips.append(x)
            x = block(F.max_pool3d(x, 2))
        x = with_global_descriptor(self.recalibrate(x))
        for up in self.up:
            x = up(x, skips.pop())
        predicted = self.fusion(x, padded_phi)[:, :, : shape[0], : shape[1], : shape[2]]
        return predicted if coarse is None else CORRECTION * predicted + to_target(coarse)


def build_network(preset: str, grid: int = 129) -> StressNetwork:
    """An untrained network. Raises :class:`ConfigError` for an unknown preset."""
    if preset not in PRESETS:
        raise ConfigError(f"preset must be one of {', '.join(PRESETS)}, not {preset!r}.")
    return StressNetwork(Architecture(**{**asdict(PRESETS[preset]), "grid": grid}))


def to_target(stress: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """log(1 + σ/k) of von Mises in MPa."""
    return torch.log1p(stress / TARGET_SCALE_MPA)


def to_stress(target: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """Von Mises in MPa, the inverse of :func:`to_target`."""
    return TARGET_SCALE_MPA * torch.expm1(target)


def crop_box(phi: Float[Tensor, "*batch x y z"]) -> Box:
    """The box about the samples with Φ ≤ 0: a margin of air all about, sides that are multiples of 16 and at least 32.

    What is added to make a multiple goes to the far end, so that the base is always at the same height in the crop. An
    axis without room for that is taken whole.

    Raises:
        ConfigError: no sample is inside.
    """
    inside = (phi <= 0).reshape(-1, *phi.shape[-3:]).any(dim=0)
    slices = []
    for axis in range(3):
        size = inside.shape[axis]
        indices = torch.nonzero(inside.transpose(0, axis).flatten(1).any(dim=1)).flatten().tolist()
        if not indices:
            raise ConfigError("Φ is positive everywhere: there is no body in the grid.")
        low = max(indices[0] - CROP_MARGIN, 0)
        length = -(-(indices[-1] + 1 + CROP_MARGIN - low) // CROP_MULTIPLE) * CROP_MULTIPLE
        length = min(max(length, CROP_MIN_SIDE), size // CROP_MULTIPLE * CROP_MULTIPLE)
        low = min(low, size - length)
        slices.append(slice(low, low + length) if indices[-1] < low + length else slice(0, size))
    return slices[0], slices[1], slices[2]

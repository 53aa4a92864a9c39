"""How the network is run: on which device, in which precision, in which crop; in training as in prediction."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from genmf_mi.core.errors import ConfigError
from genmf_mi.stress.fem.simulation import Settings
from genmf_mi.stress.model.network import Box, StressNetwork, crop_box, to_stress


def device_of(name: str) -> torch.device:
    """``cpu``, ``cuda``, or ``auto``: CUDA if there is one. Raises :class:`ConfigError` for a CUDA that is missing."""
    if name == "cuda" and not torch.cuda.is_available():
        raise ConfigError("torch finds no CUDA device here; choose --device cpu.")
    return torch.device("cuda" if name != "cpu" and torch.cuda.is_available() else "cpu")


def bfloat16_on(device: torch.device, precision: str = "auto") -> bool:
    """Whether to compute in bfloat16: ``bfloat16``, ``float32``, or ``auto``: if the device multiplies in it.

    On a CPU with AVX-512 BF16 it halves the time; on one without, it would be emulated.
    """
    if precision != "auto":
        return precision == "bfloat16"
    if device.type == "cuda":
        return torch.cuda.is_bf16_supported(including_emulation=False)
    capabilities = torch.cpu.get_capabilities()
    return bool(capabilities.get("avx512_bf16") or capabilities.get("amx_bf16"))


def log_stress(
    network: StressNetwork,
    phi: Float[Tensor, "batch 1 x y z"],
    bfloat16: bool,
    coarse: Float[Tensor, "batch 1 x y z"] | None = None,
    settings: Settings | None = None,
) -> Float[Tensor, "batch 1 x y z"]:
    """log(1 + σ/k) in the type of Φ, differentiable; all on the network's device.

    coarse, settings: see :meth:`StressNetwork.forward`.
    """
    with torch.autocast(phi.device.type, torch.bfloat16, enabled=bfloat16):
        return network(phi, coarse, settings).to(phi.dtype)


def stress(
    network: StressNetwork,
    phi: Float[Tensor, "1 x y z"],
    bfloat16: bool,
    box: Box | None = None,
    coarse: Float[Tensor, "1 x y z"] | None = None,
    settings: Settings | None = None,
) -> Float[Tensor, "1 x y z"]:
    """Von Mises in MPa on the device of Φ, zero outside of the crop; differentiable.

    Args:
        box: the crop; :func:`network.crop_box` of Φ if not given. Keep one while a shape is being changed, as the field
            jumps a little when the crop does.
        coarse, settings: see :meth:`StressNetwork.forward`.
    """
    crop = (slice(None), *(box or crop_box(phi)))
    field = torch.zeros_like(phi)
    device = next(network.parameters()).device
    cropped_coarse = None if coarse is None else coarse[crop][None].to(device)
    target = log_stress(network, phi[crop][None].to(device), bfloat16, cropped_coarse, settings)
    field[crop] = to_stress(target)[0].clamp_min(0).to(phi.device)
    return field

"""How the network is run: on which device, in which precision, in which window; in training as in prediction."""

from __future__ import annotations

import torch
from torch import Tensor

from genmf_mi.core.errors import ConfigError
from genmf_mi.stress.fem.simulation import Settings
from genmf_mi.stress.model.network import StressNetwork, to_stress, window


def device_of(name: str) -> torch.device:
    """``cpu``, ``cuda``, or ``auto``: CUDA where there is one. Raises :class:`ConfigError` for a CUDA that is not."""
    if name == "cuda" and not torch.cuda.is_available():
        raise ConfigError("torch finds no CUDA device here; choose --device cpu.")
    return torch.device("cuda" if name != "cpu" and torch.cuda.is_available() else "cpu")


def bfloat16_on(device: torch.device, precision: str = "auto") -> bool:
    """Whether to compute in bfloat16: ``bfloat16``, ``float32``, or ``auto``: where the device multiplies in it.

    On a CPU with AVX-512 BF16 it halves the time; on one without, it would be emulated.
    """
    if precision != "auto":
        return precision == "bfloat16"
    if device.type == "cuda":
        return torch.cuda.is_bf16_supported(including_emulation=False)
    there = torch.cpu.get_capabilities()
    return bool(there.get("avx512_bf16") or there.get("amx_bf16"))


def log_stress(
    network: StressNetwork,
    phi: Tensor,
    bfloat16: bool,
    coarse: Tensor | None = None,
    settings: Settings | None = None,
) -> Tensor:
    """log(1 + σ/k) ``[B,1,X,Y,Z]`` for Φ of that shape on the network's device, in the type of Φ; differentiable.

    coarse, settings: see :class:`StressNetwork`; the former of the shape of Φ.
    """
    with torch.autocast(phi.device.type, torch.bfloat16, enabled=bfloat16):
        return network(phi, coarse, settings).to(phi.dtype)


def stress(
    network: StressNetwork,
    phi: Tensor,
    bfloat16: bool,
    box: tuple[slice, slice, slice] | None = None,
    coarse: Tensor | None = None,
    settings: Settings | None = None,
) -> Tensor:
    """Von Mises in MPa ``[1,n,n,n]`` for Φ of that shape; zero outside of the window, differentiable.

    box: the window; :func:`network.window` of Φ if not given. Hold on to one while a shape is being changed, as the
    field jumps a little where the window does.
    coarse, settings: see :class:`StressNetwork`; the former ``[1,n,n,n]`` in MPa.
    """
    place = (slice(None), *(box or window(phi)))
    field = torch.zeros_like(phi)
    device = next(network.parameters()).device
    inner, known = (None if x is None else x[place][None].to(device) for x in (phi, coarse))
    field[place] = to_stress(log_stress(network, inner, bfloat16, known, settings))[0].clamp_min(0).to(phi.device)
    return field

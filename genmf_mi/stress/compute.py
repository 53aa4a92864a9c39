"""Where the network runs, and in which precision: the same for training and prediction."""

from __future__ import annotations

import torch
from torch import Tensor

from genmf_mi.errors import ConfigError
from genmf_mi.stress.network import StressNetwork


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


def log_stress(network: StressNetwork, phi: Tensor, bfloat16: bool) -> Tensor:
    """log(1 + σ/k), float32 ``[B,1,X,Y,Z]``, for Φ of that shape on the network's device; differentiable."""
    with torch.autocast(phi.device.type, torch.bfloat16, enabled=bfloat16):
        return network(phi).float()

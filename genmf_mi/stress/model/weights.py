"""Trained networks as files: safetensors, with the architecture and the record of the training in the header.

A file is good for one material, size and protocol only: what it was trained to predict is part of what it is.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict
from pathlib import Path

from genmf_mi.core.errors import GenmfError
from genmf_mi.core.files import atomic
from genmf_mi.stress.fem.protocol import Protocol
from genmf_mi.stress.fem.simulation import Settings
from genmf_mi.stress.model.network import Architecture, StressNetwork

PACKAGED = {
    "compact": "d6245629f5b1e2f0a46d60bb7e360b30bf2bfa76f584af845bf59f302996c294",
    "direct": "25e58182a9fc2c213faddb599da945dd376adbd42563ec246de27aee7fab3ebc",
}
"""The SHA-256 of each file that comes with the package, by the preset of its network."""
KEY, FORMAT = "genmf_mi_stress_network", 1
"""All in one entry of the header: safetensors writes several in a random order, and the hash would change."""
_RENAMED = {"film_w_m2k": "heat_transfer_coefficient_w_m2k", "side": "block_size"}
"""Former names of a field of :class:`Protocol` and of one of :class:`Architecture`. The weights of the package were
published with them, and so were data sets; writing their headers anew would change their SHA-256."""


class WeightsError(GenmfError):
    """A file of weights is missing, damaged, or of another network or protocol than the wanted one."""


def save(path: str | Path, network: StressNetwork, preset: str, simulation: dict, training: dict) -> str:
    """Write the weights as float16 and return the SHA-256 of the file.

    Args:
        simulation: settings of the samples (:class:`genmf_mi.stress.fem.simulation.Settings` as a dict).
        training: the record of the training, JSON.

    Raises:
        OutputError: the file cannot be written.
    """
    from safetensors.torch import save_file

    about = {
        "format": FORMAT,
        "preset": preset,
        "architecture": asdict(network.architecture),
        "simulation": simulation,
        "training": training,
    }
    tensors = {name: value.detach().cpu().half().contiguous() for name, value in network.state_dict().items()}
    with atomic(path) as temporary:
        save_file(tensors, temporary, {KEY: json.dumps(about, sort_keys=True)})
    return digest(path)


def file_of(name: str | Path) -> Path:
    """The file of a network of the package, by its preset; any other ``name`` is the path of a file."""
    return Path(__file__).with_name(f"{name}.safetensors") if name in PACKAGED else Path(name)


def load(name: str | Path, *, preset: str | None = None, simulation: dict | None = None) -> tuple[StressNetwork, dict]:
    """A network, ready to predict on the CPU, and the header of its file.

    Args:
        name: see :func:`file_of`.
        preset, simulation: what the file must hold, where given.

    Returns:
        The network, and ``preset``, ``architecture``, ``simulation`` and ``training`` by name, see :func:`save`.

    Raises:
        WeightsError: missing, damaged, truncated, of another preset or protocol, or not the file that was published.
    """
    from safetensors import SafetensorError, safe_open

    path = file_of(name)
    if not path.is_file():
        raise WeightsError(f"{path} does not exist; give weights that `genmf-mi stress train` wrote.")
    if name in PACKAGED and digest(path) != PACKAGED[str(name)]:
        raise WeightsError(f"{path} is not the file that was published (its SHA-256 differs); install it again.")
    try:
        with safe_open(path, framework="pt") as file:
            header = file.metadata() or {}
            tensors = {name: file.get_tensor(name).float() for name in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError) as error:
        raise WeightsError(f"{path} is damaged or no file of weights ({error}); get another copy.") from error
    try:
        about = json.loads(header.get(KEY, "{}"))
    except (ValueError, RecursionError):
        about = {}
    if not isinstance(about, dict) or about.get("format") != FORMAT:
        raise WeightsError(f"{path} holds no stress network that this program can read; train one again.")
    if preset is not None and about.get("preset") != preset:
        raise WeightsError(f"{path} holds the network {about.get('preset')!r}, not {preset!r}; give the other one.")
    try:
        about = {**about, **{name: with_current_names(about[name]) for name in ("architecture", "simulation")}}
        if simulation is not None:
            check_simulation(path, about["simulation"], simulation)
        network = StressNetwork(Architecture(**about["architecture"]))
        network.load_state_dict(tensors)
    except (AttributeError, KeyError, RuntimeError, TypeError, ValueError) as error:
        raise WeightsError(f"{path} does not fit its own description; get another copy.") from error
    return network.eval().requires_grad_(False), about


def check_simulation(path: str | Path, trained: dict, wanted: dict) -> None:
    """Raises :class:`WeightsError` where two simulations differ in anything but the fineness of their mesh."""
    flat = [
        {**simulation, **simulation["protocol"], "protocol": None, "edge_mm": None} for simulation in (trained, wanted)
    ]
    different = sorted(key for key in flat[0].keys() | flat[1].keys() if flat[0].get(key) != flat[1].get(key))
    if different:
        raise WeightsError(
            f"{path} is for another simulation ({', '.join(different)} differ); use weights trained for this one."
        )


def with_current_names(record: dict) -> dict:
    """A record from a file, nested or not, with the current names of what had other names before."""
    return {
        _RENAMED.get(key, key): with_current_names(value) if isinstance(value, dict) else value
        for key, value in record.items()
    }


def digest(path: str | Path) -> str:
    """SHA-256 of a file."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def settings_of(simulation: dict) -> Settings:
    """The settings that a ``simulation`` in the header of a file or in a data set describes."""
    return Settings(**{**simulation, "protocol": Protocol(**simulation["protocol"])})

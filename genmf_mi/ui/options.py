"""What a job may be asked for: the settings of :mod:`genmf_mi.core.config` that the page shows, as data."""

from __future__ import annotations

import ast
import inspect
from dataclasses import asdict, replace
from functools import lru_cache
from math import isfinite
from typing import Any, Literal, get_args, get_origin, get_type_hints

from genmf_mi.assets.suffixes import MESHES
from genmf_mi.core import config
from genmf_mi.core.config import PRESETS, RefineConfig
from genmf_mi.core.errors import ConfigError
from genmf_mi.core.frame import DIRECTIONS
from genmf_mi.core.printer import PRINTERS
from genmf_mi.report.pictures import PLASTIC, RELIEF_COLOURS
from genmf_mi.ui.uploads import MAX_BYTES

SHOWN = ("printer", "size_mm", "max_relief_mm", "stand", "material", "nozzle_mm")
"""Settings that the page offers; a request may hold any other of :class:`RefineConfig` as well."""
REFUSED = ("device", "weights")
"""Settings that are the server's, and nested ones."""
LOOK = {
    "material": {
        "albedo": 0.8,
        "ambient": 0.2,
        "sharpness": 8.0,
        "key": [-0.4, 0.5, 1.0],
        "fill": [0.8, 0.1, 0.6],
        "key_weight": 0.75,
        "fill_weight": 0.25,
        "lights": "camera",
    },
    "plastic": PLASTIC,
    "colours": RELIEF_COLOURS,
}
"""How the page shades, as the bundled scenes do; reading them takes Mitsuba, so a test compares."""
UPS = ("auto", "x", "-x", "y", "-y", "z", "-z")
"""Axes of a file that can point upwards, as the option ``--up`` has them."""


def options() -> dict[str, Any]:
    """What ``GET /api/options`` answers: choices, defaults and help as ``core/config.py`` has them."""
    kinds, text = get_type_hints(RefineConfig), _help("RefineConfig")
    return {
        "settings": [{"name": name, "help": text[name], **_kind(kinds[name])} for name in SHOWN],
        "presets": {name: {key: getattr(preset, key) for key in SHOWN} for name, preset in PRESETS.items()},
        "preset": "default",
        "up": list(UPS),
        "directions": {name: list(up) for name, up in DIRECTIONS.items()},
        "printers": {
            name: {
                "layered": printer.layered,
                "layer_mm": printer.layer_mm,
                "bulge": printer.bulge,
                "bed_mm": [x if isfinite(x) else None for x in printer.bed_mm],
            }
            for name, printer in PRINTERS.items()
        },
        "look": LOOK,
        "max_bytes": MAX_BYTES,
        "suffixes": list(MESHES),
    }


def configured(wanted: object) -> tuple[str, str, RefineConfig]:
    """The preset, the axis that points upwards, and all settings for what a request asks for.

    Args:
        wanted: an object with ``preset``, ``up`` and any settings by name.

    Raises:
        ConfigError: an unknown name, a value of another type, or out of range.
    """
    if not isinstance(wanted, dict):
        raise ConfigError("settings must be an object of names and values.")
    given: dict[str, Any] = {str(name): value for name, value in wanted.items()}
    preset, up = given.pop("preset", "default"), given.pop("up", "auto")
    if preset not in PRESETS:
        raise ConfigError(f"there is no preset {preset}: choose one of {', '.join(PRESETS)}.")
    if up not in UPS:
        raise ConfigError(f"{up} is no axis that could point upwards: choose one of {', '.join(UPS)}.")
    kinds = get_type_hints(RefineConfig)
    values = {name: _value(name, kinds.get(name), value) for name, value in given.items()}
    return preset, up, replace(PRESETS[preset], **values)


def arguments(preset: str, up: str, chosen: RefineConfig) -> list[str]:
    """The words for ``genmf-mi refine`` that make these settings."""
    words, default = ["--preset", preset, f"--up={up}"], asdict(PRESETS[preset])
    for name, value in asdict(chosen).items():
        option = name.replace("_", "-")
        if value == default[name] or name in REFUSED:
            continue
        if isinstance(value, bool):
            words.append(f"--{option}" if value else f"--no-{option}")
        elif isinstance(value, (list, tuple)):
            words += [f"--{option}", *map(str, value)]
        else:
            words += [f"--{option}", str(value)]
    return words


def _value(name: str, kind: Any, value: Any) -> Any:
    if kind is None or name in REFUSED:
        raise ConfigError(f"there is no setting {name}.")
    if get_origin(kind) is Literal:
        if value not in get_args(kind):
            raise ConfigError(f"{name} cannot be {value}: choose one of {', '.join(get_args(kind))}.")
        return value
    if get_origin(kind) is tuple:
        count = len(get_args(kind))
        if not isinstance(value, list) or len(value) != count or not all(_is_number(each) for each in value):
            raise ConfigError(f"{name} must be {count} numbers.")
        return tuple(float(each) for each in value)
    fits = {bool: isinstance(value, bool), int: _is_number(value) and value == int(value), float: _is_number(value)}
    if not fits.get(kind, False):
        raise ConfigError(f"{name} cannot be {value!r}.")
    return kind(value)


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and isfinite(value)


def _kind(kind: Any) -> dict[str, Any]:
    if get_origin(kind) is Literal:
        return {"type": "choice", "choices": list(get_args(kind))}
    return {"type": {float: "number", int: "integer", bool: "switch"}[kind]}


@lru_cache(maxsize=2)
def _help(name: str) -> dict[str, str]:
    """The docstring of every field of a dataclass of ``core/config.py``, which Python itself does not keep."""
    tree = ast.parse(inspect.getsource(config))
    (block,) = (node for node in tree.body if isinstance(node, ast.ClassDef) and node.name == name)
    return {
        ast.unparse(node.target): " ".join(str(after.value.value).split())
        for node, after in zip(block.body, block.body[1:])
        if isinstance(node, ast.AnnAssign) and isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)
    }

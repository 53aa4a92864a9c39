"""What is asked of one refinement, and how the cells of a manifest change it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from difflib import get_close_matches
from functools import cache
from pathlib import Path
from typing import Any, Literal, get_args, get_origin, get_type_hints

from genmf_mi.core.config import PRESETS, RefineConfig, Weights
from genmf_mi.core.errors import ConfigError
from genmf_mi.core.regions import VERTEX_COLOURS, Regions


@dataclass(frozen=True)
class Work:
    """The settings of a refinement and what else :func:`genmf_mi.refine` takes, but for asset, folder and progress."""

    config: RefineConfig = field(default_factory=RefineConfig)
    textured: str | None = None
    up: str | None = None
    files_anywhere: bool = False
    scene: str | None = None
    references: tuple[str, ...] = ()
    verify: bool = False
    print_check: bool = False
    slicer: str = "auto"
    save_exr: bool = False

    def keywords(self) -> dict[str, Any]:
        """For :func:`genmf_mi.refine`."""
        return {
            "textured": self.textured,
            "up": self.up,
            "files_anywhere": self.files_anywhere,
            "scene": self.scene,
            "references": self.references,
            "verify": self.verify,
            "print_check": self.slicer if self.print_check else False,
            "save_exr": self.save_exr,
        }

    def described(self) -> dict[str, Any]:
        """All that decides the result, as plain types; where it is computed does not count."""
        options = {one.name: getattr(self, one.name) for one in fields(self) if one.name != "config"}
        config = {name: value for name, value in self.config.to_dict().items() if name != "device"}
        painted = self.config.regions
        if isinstance(painted, Regions):
            config["regions"] = painted.to_json()
        return {**config, **options, "references": list(self.references)}

    @property
    def painted(self) -> dict[str, str]:
        """The files that say where there shall be more or less relief, by the setting that names them."""
        named = {"regions": self.config.regions, "mask": self.config.mask}
        return {key: str(one) for key, one in named.items() if isinstance(one, str | Path) and one != VERTEX_COLOURS}

    def with_painted(self, change: Callable[[str, str], str]) -> Work:
        """With what ``change(setting, file)`` gives in place of each of these files."""
        changed: dict[str, Any] = {key: change(key, file) for key, file in self.painted.items()}
        return replace(self, config=replace(self.config, **changed)) if changed else self


_OPTIONS: dict[str, Any] = {
    "preset": Literal["draft", "default", "paper"],
    "textured": str,
    "up": Literal["auto", "x", "-x", "y", "-y", "z", "-z"],
    "files_anywhere": bool,
    "scene": str,
    "reference": tuple[str, ...],
    "verify": bool,
    "print_check": bool,
    "slicer": str,
    "save_exr": bool,
}
FILES = ("textured", "scene", "reference", "regions", "mask")
"""Settings that name files."""


@cache
def known() -> dict[str, Any]:
    """Every setting that an item may have, and its type: those of the command ``refine``."""
    config = {name: hint for name, hint in get_type_hints(RefineConfig).items() if name != "weights"}
    return {**_OPTIONS, **config, "regions": str, "mask": str, **get_type_hints(Weights)}


def setting_name(name: str) -> str:
    """The setting that ``name`` means, as a column or on the command line. Raises :class:`ConfigError`."""
    plain = name.strip().lower().replace("-", "_").removeprefix("weights.")
    if plain in known():
        return plain
    close = get_close_matches(plain, known(), 1)
    hint = f" Did you mean {close[0]}?" if close else " See `genmf-mi refine --help`."
    raise ConfigError(f"there is no setting {name!r}.{hint}")


def with_settings(work: Work, settings: Mapping[str, Any]) -> Work:
    """``work`` with other ``settings`` by name, values as in JSON or as text; a ``preset`` replaces all that
    ``work`` has of :class:`RefineConfig` before the others count.

    Raises:
        ConfigError: a setting that does not exist, or a value that it cannot have.
    """
    values = {(setting := setting_name(name)): _value(setting, value) for name, value in settings.items()}
    config = PRESETS[values.pop("preset")] if "preset" in values else work.config
    weights = {one.name: values.pop(one.name) for one in fields(Weights) if one.name in values}
    changed = {one.name: values.pop(one.name) for one in fields(RefineConfig) if one.name in values}
    if weights:
        changed["weights"] = replace(config.weights, **weights)
    if "reference" in values:
        values["references"] = values.pop("reference")
    if "up" in values:
        values["up"] = None if values["up"] == "auto" else values["up"]
    return replace(work, config=replace(config, **changed), **values)


def _value(name: str, value: Any) -> Any:
    """``value`` as the type of the setting."""
    hint = known()[name]
    try:
        return _typed(hint, value)
    except (TypeError, ValueError):
        pass
    choices = get_args(hint) if get_origin(hint) is Literal else ()
    wanted = f"one of {', '.join(choices)}" if choices else _WANTED.get(hint, "a list")
    raise ConfigError(f"{name.replace('_', '-')} must be {wanted}, not {value!r}.")


_WANTED = {bool: "true or false", int: "a whole number", float: "a number", str: "text"}
_TRUTH = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}


def _typed(hint: Any, value: Any) -> Any:
    """Raises :class:`TypeError` or :class:`ValueError` for a value that is not of the type."""
    if get_origin(hint) is Literal:
        if value not in get_args(hint):
            raise ValueError(value)
        return value
    if get_origin(hint) is tuple:
        inner = get_args(hint)[0]
        parts = value.split(";" if inner is str else ",") if isinstance(value, str) else list(value)
        if inner is not str and len(parts) != len(get_args(hint)):
            raise ValueError(value)
        return tuple(_typed(inner, part.strip() if isinstance(part, str) else part) for part in parts if part != "")
    if hint is bool:
        if isinstance(value, str):
            return _TRUTH[value.strip().lower()] if value.strip().lower() in _TRUTH else _refuse(value)
        return value if isinstance(value, bool) else _refuse(value)
    if hint is str:
        return value if isinstance(value, str) else _refuse(value)
    if isinstance(value, bool) or (hint is int and float(value) != int(float(value))):
        raise ValueError(value)
    return hint(float(value)) if hint is int else hint(value)


def _refuse(value: Any) -> Any:
    raise ValueError(value)

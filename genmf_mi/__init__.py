"""Turns a textured 3D asset into a one-colour printable part whose relief shows the texture.

    import genmf_mi

    result = genmf_mi.refine("bus.glb", genmf_mi.RefineConfig(size_mm=100.0))

Importing the package starts neither Mitsuba nor torch: what it offers is imported at first use.
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from genmf_mi.asset import load
    from genmf_mi.config import RefineConfig
    from genmf_mi.evaluate import evaluate
    from genmf_mi.refine import Result, refine

__version__ = "0.1.0"
__all__ = ["RefineConfig", "Result", "evaluate", "load", "refine"]

_HOME = {
    "RefineConfig": "genmf_mi.config",
    "Result": "genmf_mi.refine",
    "evaluate": "genmf_mi.evaluate",
    "load": "genmf_mi.asset",
    "refine": "genmf_mi.refine",
}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = import_module(_HOME[name])
    return module if module.__name__ == f"{__name__}.{name}" else getattr(module, name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


class _CallableModule(ModuleType):
    """A module that may be called like the function it is named after."""

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        return self.__wrapped__(*args, **kwargs)

    @property
    def __wrapped__(self) -> Any:  # where `inspect.signature` looks
        return vars(self)[self.__name__.rpartition(".")[2]]


class _Package(ModuleType):
    """Makes ``genmf_mi.refine`` and ``genmf_mi.evaluate``, which are modules and functions of the same name, callable.

    Python sets a submodule as an attribute of its package at its first import, whoever imports it, so that a function
    of that name would be lost.
    """

    def __setattr__(self, name: str, value: Any) -> None:
        if isinstance(value, ModuleType) and _HOME.get(name) == value.__name__:
            value.__class__ = _CallableModule
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package

"""Turns a textured 3D asset into a one-colour printable part whose relief shows the texture.

    import genmf_mi

    result = genmf_mi.refine("bus.glb", genmf_mi.RefineConfig(size_mm=100.0))

Importing the package starts neither Mitsuba nor torch: what it offers is imported at first use. The whole public
interface is described in ``docs/api.md``.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from genmf_mi.assets.asset import Asset, load
    from genmf_mi.assets.sdf_asset import SdfAsset
    from genmf_mi.batch.engine import run_batch
    from genmf_mi.batch.items import BatchItem
    from genmf_mi.batch.journal import BatchOutcome
    from genmf_mi.batch.task import Limits
    from genmf_mi.core.config import RefineConfig
    from genmf_mi.core.regions import Regions, Stroke
    from genmf_mi.pipeline.evaluation import evaluate
    from genmf_mi.pipeline.print_check import print_check
    from genmf_mi.pipeline.refinement import refine
    from genmf_mi.pipeline.results import Result

__version__ = "0.1.0"
__all__ = [
    "Asset",
    "BatchItem",
    "BatchOutcome",
    "Limits",
    "RefineConfig",
    "Regions",
    "Result",
    "SdfAsset",
    "Stroke",
    "evaluate",
    "load",
    "print_check",
    "refine",
    "run_batch",
]

_DEFINED_IN = {
    "Asset": "genmf_mi.assets.asset",
    "BatchItem": "genmf_mi.batch.items",
    "BatchOutcome": "genmf_mi.batch.journal",
    "Limits": "genmf_mi.batch.task",
    "RefineConfig": "genmf_mi.core.config",
    "Regions": "genmf_mi.core.regions",
    "Result": "genmf_mi.pipeline.results",
    "SdfAsset": "genmf_mi.assets.sdf_asset",
    "Stroke": "genmf_mi.core.regions",
    "evaluate": "genmf_mi.pipeline.evaluation",
    "load": "genmf_mi.assets.asset",
    "print_check": "genmf_mi.pipeline.print_check",
    "refine": "genmf_mi.pipeline.refinement",
    "run_batch": "genmf_mi.batch.engine",
}


def __getattr__(name: str) -> Any:
    if name not in _DEFINED_IN:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_DEFINED_IN[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})

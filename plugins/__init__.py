"""Mitsuba plugins of genmf_mi: the BSDF ``twolight`` and the integrator ``monochrome``.

Mitsuba binds a Python plugin to the variant that is active while its class is created. Importing this package therefore
registers the plugins for the current variant and for every variant that is activated later, so that plain XML can
use them after ``import genmf_mi.plugins``.
"""

from __future__ import annotations

import importlib
import sys

import mitsuba as mi

_registered: set[str] = set()


def _register(_previous: str | None, variant: str) -> None:
    """Create the plugin classes on the types of ``variant``, as Mitsuba does for its own Python integrators."""
    if variant in _registered:
        return
    # The integrator stands on Mitsuba's AD integrators, which scalar variants do not have.
    for name in ["twolight"] if variant.startswith("scalar") else ["twolight", "monochrome"]:
        qualified = f"{__name__}.{name}"
        if qualified in sys.modules:
            importlib.reload(sys.modules[qualified])
        else:
            importlib.import_module(qualified)
    _registered.add(variant)


mi.detail.add_variant_callback(_register)
if mi.variant() is not None:
    _register(None, mi.variant())

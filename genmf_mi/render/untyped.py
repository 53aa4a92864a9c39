"""Mitsuba and Dr.Jit without static types, for the other modules of this folder.

Their classes belong to the variant that is chosen at run time (``mi.Float`` is another class in each), and their stubs
describe none of them in full, so that a type checker would object to correct code and miss mistakes.
"""

from __future__ import annotations

from typing import Any, TypeAlias

from genmf_mi.core import llvm
from genmf_mi.core.errors import SetupError

try:
    import drjit
    import mitsuba
except (ImportError, NameError) as error:  # Dr.Jit stumbles over a name while it explains a missing library
    raise SetupError(f"Mitsuba cannot be loaded: {error.__context__ or error}. {llvm.advice()}") from error

dr: Any = drjit
mi: Any = mitsuba

MitsubaScene: TypeAlias = Any
"""A loaded ``mi.Scene``."""
MitsubaObject: TypeAlias = Any
"""A sensor, an integrator, a BSDF or the result of ``mi.traverse``."""

"""Mitsuba and Dr.Jit without static types, for the other modules of this folder.

Their classes belong to the variant that is chosen at run time (``mi.Float`` is another class in each), and their stubs
describe none of them in full, so that a type checker would object to correct code and miss mistakes.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import drjit
import mitsuba

dr: Any = drjit
mi: Any = mitsuba

MitsubaScene: TypeAlias = Any
"""A loaded ``mi.Scene``."""
MitsubaObject: TypeAlias = Any
"""A sensor, an integrator, a BSDF or the result of ``mi.traverse``."""

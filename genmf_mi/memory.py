"""How much memory the process holds, and giving back what it no longer uses."""

from __future__ import annotations

import ctypes
import resource
import sys


def peak_gb() -> float:
    """The largest resident set of this process so far, in GB."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1e9 if sys.platform == "darwin" else 1e6)


def give_back() -> None:
    """Return freed memory to the system where the C library can (glibc).

    Images of ever new sizes leave the heap in pieces: without this, a refinement grows by some 100 MB every 100
    iterations although nothing is held.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None) if sys.platform == "linux" else None
    if trim is not None:
        trim(0)

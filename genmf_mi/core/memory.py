"""How much memory the process holds, and giving back what it no longer uses."""

from __future__ import annotations

import ctypes
import resource
import sys


def peak_gb() -> float:
    """The largest resident set of this process so far, in GB."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1e9 if sys.platform == "darwin" else 1e6)


_TRIM_THRESHOLD, _TOP_PAD, _MMAP_THRESHOLD = -1, -2, -3
"""The parameters of ``mallopt`` (malloc.h)."""


def tune_malloc() -> None:
    """Have the C library (glibc) use freed memory again instead of returning it to the system at once.

    Every iteration takes and frees arrays of the same sizes by the dozen. Fresh pages for each of them took three
    quarters of the time that FlexiCubes takes at 129³. :func:`trim_malloc` still returns them.
    """
    options = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform == "linux" else None
    if options is not None:
        for parameter, size in ((_MMAP_THRESHOLD, 32 << 20), (_TRIM_THRESHOLD, 1 << 30), (_TOP_PAD, 64 << 20)):
            options(parameter, size)


def trim_malloc() -> None:
    """Return freed memory to the system where the C library can (glibc).

    Images of ever new sizes leave the heap in pieces: without this, a refinement grows by some 100 MB every 100
    iterations although nothing is held.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None) if sys.platform == "linux" else None
    if trim is not None:
        trim(0)

"""How much memory the process holds, and giving back what it no longer uses."""

from __future__ import annotations

import ctypes
import os
import resource
import sys
from contextlib import suppress
from pathlib import Path


def resident_gb(process: int) -> float:
    """The resident set of a process in GB; 0 where the system does not tell (outside of Linux), or it has ended."""
    try:
        pages = int(Path(f"/proc/{process}/statm").read_text(encoding="ascii").split()[1])
    except (OSError, ValueError, IndexError):
        return 0.0
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e9


def available_gb() -> float:
    """Memory in GB that this process and its children may still take: of the machine, and of its container."""
    rooms = [_machine_gb()]
    for limit, used in (
        ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory.current"),
        ("/sys/fs/cgroup/memory/memory.limit_in_bytes", "/sys/fs/cgroup/memory/memory.usage_in_bytes"),
    ):
        with suppress(OSError, ValueError):  # "max" for none
            most, now = (int(Path(file).read_text(encoding="ascii")) for file in (limit, used))
            rooms.append((most - now) / 1e9)
    return max(0.0, min(rooms))


def _machine_gb() -> float:
    with suppress(OSError, ValueError):
        for line in Path("/proc/meminfo").read_text(encoding="ascii").splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) * 1024 / 1e9
    return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 1e9


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

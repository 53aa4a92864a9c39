"""A process that takes inputs one after the other, and the parent's side of it, which ends it where it hangs or swells.

Run as a program it is the process. It reads a line ``KIND PATH`` for each input from standard input and answers with a
line of JSON.
"""

from __future__ import annotations

import json
import os
import selectors
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from pathlib import Path
from typing import IO, Any

SECONDS, LONGEST, MEMORY = 60.0, 300.0, 2 * 1024**3
"""Limits for one input: of CPU time, since the machine may be busy, of time, and of memory above that at the start."""
READ, WARNED, REFUSED, FOREIGN = "read", "warned", "refused", "foreign"
OUTCOMES = (READ, WARNED, REFUSED, FOREIGN)
HERE = Path(__file__).parent


class Worker:
    """One process, which is started again where it ended."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._errors: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115  (of the process, which outlives this call)
        self._base = 0

    def run(self, kind: str, path: Path) -> dict[str, Any]:
        """What became of one input: ``outcome``, ``error``, ``where``, ``seconds``, ``megabytes`` above the start."""
        process = self._started()
        assert process.stdin and process.stdout
        start, begun = time.monotonic(), _cpu_seconds(process.pid)
        process.stdin.write(f"{kind} {path}\n".encode())
        process.stdin.flush()
        with selectors.DefaultSelector() as selector:
            selector.register(process.stdout, selectors.EVENT_READ)
            while not selector.select(0.05):
                grown = _resident(process.pid) - self._base
                late = _cpu_seconds(process.pid) - begun > SECONDS or time.monotonic() - start > LONGEST
                if late or grown > MEMORY:
                    self.close()
                    what = f"no end after {SECONDS:.0f} s" if late else f"{grown / 1e6:.0f} MB are taken"
                    return {"outcome": FOREIGN, "error": what, "where": "", "seconds": time.monotonic() - start,
                            "megabytes": round(grown / 1e6)}  # fmt: skip
        line = process.stdout.readline()
        if not line:
            code = process.wait()
            self._errors.seek(0)
            last = self._errors.read()[-1500:].decode(errors="replace")
            self.close()
            return {"outcome": FOREIGN, "error": f"the process ended with {code}", "where": last,
                    "seconds": time.monotonic() - start, "megabytes": 0}  # fmt: skip
        return json.loads(line)

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
            self._process = None
        self._errors.close()

    def _started(self) -> subprocess.Popen[bytes]:
        if self._process is None:
            self._errors.close()
            self._errors = tempfile.TemporaryFile()  # noqa: SIM115
            one_thread = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "MKL", "OPENBLAS")}
            self._process = subprocess.Popen(
                [sys.executable, str(HERE / "fuzz_worker.py")], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                stderr=self._errors, env={**os.environ, **one_thread},
            )  # fmt: skip
            assert self._process.stdout
            if not self._process.stdout.readline():
                self._errors.seek(0)
                raise RuntimeError(self._errors.read().decode(errors="replace"))
            self._base = _resident(self._process.pid)
        return self._process


def _resident(process: int | str) -> int:
    """Bytes."""
    try:
        return int(Path(f"/proc/{process}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, IndexError):
        return 0


def _cpu_seconds(process: int) -> float:
    try:
        words = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
        return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")
    except (OSError, IndexError):
        return 0.0


def _peak() -> int:
    """The largest resident set since :func:`_forget_peak`, bytes."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmHWM"):
            return int(line.split()[1]) * 1024
    return 0


def _forget_peak() -> None:
    Path("/proc/self/clear_refs").write_text("5")


def main() -> None:
    """Answer until the parent is gone."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what libraries print is no answer
    sys.path[:0] = [str(HERE.parent), str(HERE.parents[1])]
    import faulthandler

    faulthandler.enable()
    import fuzz_drive
    import fuzz_seeds

    from genmf_mi.core.errors import GenmfError

    fuzz_drive.make_affordable()
    with tempfile.TemporaryDirectory() as folder:
        fuzz_drive.drive("glb", fuzz_seeds.seeds("glb")[0].write(Path(folder)), Path(folder))
    _limit_memory()
    print("ready", file=answers, flush=True)
    for line in sys.stdin:
        kind, _, path = line.rstrip("\n").partition(" ")
        _forget_peak()
        before, start = _resident("self"), time.monotonic()
        outcome, error, where = READ, "", ""
        with warnings.catch_warnings(record=True) as caught, tempfile.TemporaryDirectory() as scratch:
            warnings.simplefilter("always")
            try:
                said = fuzz_drive.drive(kind, Path(path), Path(scratch))
            except GenmfError as refusal:
                outcome, error = REFUSED, str(refusal)
                if _of_memory(refusal):
                    outcome, where = FOREIGN, traceback.format_exc()
            except BaseException as fault:
                outcome, error, where = FOREIGN, f"{type(fault).__name__}: {fault}", traceback.format_exc()
            else:
                said = [*said, *(f"{one.category.__name__}: {one.message}" for one in caught)]
                outcome, error = (WARNED, said[0]) if said else (READ, "")
        taken = _peak() - before
        if taken > MEMORY:
            outcome, error = FOREIGN, f"{taken / 1e6:.0f} MB are taken"
        answer = {"outcome": outcome, "error": error[:500], "where": where[-3000:],
                  "seconds": round(time.monotonic() - start, 3), "megabytes": round(taken / 1e6)}  # fmt: skip
        print(json.dumps(answer), file=answers, flush=True)


def _limit_memory() -> None:
    """Address space too, which is taken before it is touched."""
    import resource

    size = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    resource.setrlimit(resource.RLIMIT_AS, (size + 2 * MEMORY, resource.RLIM_INFINITY))


def _of_memory(error: BaseException | None) -> bool:
    """Whether there was no memory behind an error of ours."""
    while error is not None:
        if isinstance(error, MemoryError):
            return True
        error = error.__cause__ or error.__context__
    return False


if __name__ == "__main__":
    main()

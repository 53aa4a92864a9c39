"""The command ``genmf-mi``: finds the command that is named, and turns errors into exit codes.

Only the standard library is imported until a command runs, so that ``--help`` answers at once. Each command is a module
beside this one, named like the command, with ``main(arguments) -> exit code``.
"""

from __future__ import annotations

import gc
import io
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib import import_module

from genmf_mi.core.errors import GenmfError

SPINS = "10000"
"""Turns that a thread of OpenMP (GNU's, as in PyTorch) waits for the others before it sleeps. With its own 300,000 a
draft takes 143 s instead of 41 s beside one busy process on two cores; on idle ones nothing is lost."""
INTERRUPTED, UNHEARD, TERMINATED = 130, 141, 143
"""Exit codes after Ctrl-C, where nobody reads the output any more, and after SIGTERM, as shells have them: 128 + the
signal."""

COMMANDS = {
    "refine": ("ASSET", "refine a file or a bundled sample; writes to runs/NAME"),
    "ui": ("", "a page in the browser: drop a file, paint, start, compare, download"),
    "evaluate": ("A B", "score a one-colour shape B against the textured asset A"),
    "print-check": ("PART", "slice a part and look at it as it comes off the printer"),
    "batch": ("FILES ...", "refine many assets: on this machine, a shard of them, or on a cluster"),
    "merge": ("OUT", "a table and a gallery of a batch, from all its shards"),
    "sweep": ("ASSET", "what a lower thermal stress costs in appearance"),
    "convert": ("ASSET", "from a mesh to an SDF file, or from an SDF file to a coloured mesh"),
    "scene": ("ASSET", "print a scene file to edit and use with --scene"),
    "samples": ("", "write the bundled samples as GLB files"),
    "stress": ("...", "thermal stress by finite elements and by the trained network"),
    "weights": ("", "install the LPIPS weights"),
    "doctor": ("", "check the installation: what is missing and how to install it"),
}
"""Arguments and summary of each command."""

USAGE = "\n".join(
    [
        "genmf-mi: turn a textured 3D asset into a one-colour part whose relief shows the texture",
        "",
        *(f"  {f'genmf-mi {name} {arguments}':<28}{summary}" for name, (arguments, summary) in COMMANDS.items()),
        "",
        "Each command has --help.",
        "",
    ]
)


def main(arguments: list[str] | None = None) -> int:
    """Run a command; returns the exit code.

    Errors of the input or the machine end in one line on standard error and exit code 2; a traceback is a defect of
    this package.
    """
    os.environ.setdefault("GOMP_SPINCOUNT", SPINS)
    try:
        try:
            with _terminable():
                return _run(sys.argv[1:] if arguments is None else arguments)
        finally:
            sys.stdout.flush()  # while it can still be told from other faults
    except BrokenPipeError:
        # Python flushes standard streams again at its end (its documentation of SIGPIPE)
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError, ValueError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
        return UNHEARD


@contextmanager
def _terminable() -> Iterator[None]:
    """Have SIGTERM end the process as an exception does, so that a run keeps its state and no scratch files stay."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def end(*_: object) -> None:
        raise SystemExit(TERMINATED)

    before = signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _run(arguments: list[str]) -> int:
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal that lacks a character shows "?"
    if not arguments or arguments[0] in ("-h", "--help"):
        print(USAGE)
        return 0 if arguments else 2
    command, *rest = arguments
    if command == "--version":
        from genmf_mi import __version__

        print(__version__)
        return 0
    if command not in COMMANDS:
        print(f"error: there is no command {command!r}.\n\n{USAGE}", file=sys.stderr)
        return 2
    try:
        return import_module(f"genmf_mi.cli.{command.replace('-', '_')}").main(rest)
    except GenmfError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    except BrokenPipeError:
        raise
    except OSError as error:  # a fault of the machine, wherever it shows
        print(f"error: {error}. Check the path, its permissions and the space on the disk.", file=sys.stderr)
        return GenmfError.exit_code
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return INTERRUPTED
    finally:
        gc.collect()  # solvers in reference cycles make nanobind report leaks at exit

"""The process of a job: started below the priority of everything else, found again by a server that was restarted.

A process holds a lock on a file in the folder of its job for as long as it lives, whoever its parent is. What it says
goes into files of that folder and not through pipes, so that it survives the server.
"""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import IO

try:
    import fcntl
except ImportError:  # Windows, where a job does not survive its server
    fcntl = None

NICE = 10
"""Steps below the priority of the server, so that the page answers while all cores are busy."""
GRACE = 8.0
"""Seconds for a process to save what it has once it was told to end."""
PROGRAM = (sys.executable, "-m", "genmf_mi")
_LOCK = ".process"
_children: list[subprocess.Popen[bytes]] = []
"""Those that run; they may outlive all who look at them."""


class Process:
    """A running process in ``folder``, our own child or one that an earlier server has started."""

    def __init__(self, folder: Path, pid: int, child: subprocess.Popen[bytes] | None = None) -> None:
        self.folder, self.pid, self._child = folder, pid, child
        self._asked = 0.0

    @property
    def alive(self) -> bool:
        """Whether it still runs."""
        if self._child is not None:
            return self._child.poll() is None
        return is_locked(self.folder)

    @property
    def exit_code(self) -> int | None:
        """Of an own child that has ended, negative for a signal."""
        return self._child.poll() if self._child is not None else None

    def end(self) -> None:
        """End it and all that it has started: asked first, so that it can save what it has, then forced. To be called
        until it has ended."""
        if not self.alive:
            return
        if self._asked and time.monotonic() - self._asked < GRACE:
            return
        with suppress(OSError):
            if hasattr(os, "killpg"):
                os.killpg(self.pid, signal.SIGKILL if self._asked else signal.SIGTERM)
            else:
                os.kill(self.pid, signal.SIGTERM)
        self._asked = time.monotonic()


def start(arguments: Sequence[str], folder: Path, where: Path) -> Process:
    """Start ``genmf-mi`` with arguments. Its output is appended to ``events.jsonl`` and ``log.txt`` in ``folder``.

    where: its working folder.
    """
    command = [*PROGRAM, *arguments]
    environment = {**os.environ, "PYTHONUNBUFFERED": "1", "PYTHONSAFEPATH": "1"}
    with (folder / "events.jsonl").open("ab") as out, (folder / "log.txt").open("ab") as log, _locked(folder) as lock:
        child = subprocess.Popen(
            command, cwd=where, env=environment, stdin=subprocess.DEVNULL, stdout=out, stderr=log,
            start_new_session=True, pass_fds=[lock.fileno()] if fcntl else (),
        )  # fmt: skip
    _children[:] = [each for each in _children if each.poll() is None] + [child]
    lower(child.pid)
    return Process(folder, child.pid, child)


def lower(pid: int) -> None:
    """Give a process less priority than the server."""
    if hasattr(os, "setpriority"):
        with suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, pid, os.getpriority(os.PRIO_PROCESS, 0) + NICE)


def find(folder: Path, pid: int) -> Process | None:
    """The process of an earlier server that still runs in ``folder``."""
    return Process(folder, pid) if pid and is_locked(folder) else None


def is_locked(folder: Path) -> bool:
    """Whether a process runs in ``folder``."""
    if fcntl is None or not (folder / _LOCK).exists():
        return False
    with (folder / _LOCK).open("a") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False


def last_error(log: Path, start_at: int) -> str:
    """What a process has given as the reason of its end: the text of the last line that begins with ``error:``."""
    try:
        with log.open("rb") as file:
            file.seek(start_at)
            text = file.read(1 << 20).decode("utf-8", "replace")
    except OSError:
        return ""
    found = re.findall(r"^error: (.*)$", text, re.MULTILINE)
    return found[-1].strip() if found else ""


def _locked(folder: Path) -> IO[str]:
    """A file that is locked for as long as it, or a copy that a child has inherited, is open."""
    file = (folder / _LOCK).open("a")
    if fcntl is not None:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    return file

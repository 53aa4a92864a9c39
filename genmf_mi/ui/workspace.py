"""Jobs on disk. A job is a folder::

job.json        what it is called, what it was asked for, and how it stands
draft.json      settings and painted regions that were not started yet
input/          the uploaded files
model.glb       the model as the page draws it, made of files that the page cannot read itself
analysis.json   size, faces, and what was found on making it solid
regions.json    the painted regions of the run
events.jsonl    what the process said, see ``genmf-mi refine --json-progress``
log.txt         its standard error
run/            its results
"""

from __future__ import annotations

import json
import os
import re
import secrets
import shutil
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

from genmf_mi.core.errors import OutputError
from genmf_mi.core.files import locked, write_text

READY, QUEUED, RUNNING, FINISHED, FAILED, CANCELLED = "ready", "queued", "running", "finished", "failed", "cancelled"
STATES = (READY, QUEUED, RUNNING, FINISHED, FAILED, CANCELLED)
KEPT_DELETED = 24 * 3600.0
"""Seconds for which a deleted job can be brought back."""
_ID = re.compile(r"[0-9]{8}-[0-9]{6}-[0-9a-f]{8}")


@dataclass(frozen=True)
class Job:
    """How a job stands; times in seconds since 1970.

    model: the file to refine, below ``input``. settings: as :func:`genmf_mi.ui.options.configured` takes them.
    cancel: somebody wants it to end. attempts: how often a process was started for it. kept: it was ended early, and
    what there was is its result. error: what the process said last, or what happened to it.
    """

    id: str
    name: str
    model: str
    created: float
    state: str = READY
    settings: dict[str, Any] | None = None
    regions: bool = False
    queued: float = 0.0
    started: float = 0.0
    ended: float = 0.0
    pid: int = 0
    log_from: int = 0
    attempts: int = 0
    cancel: bool = False
    kept: bool = False
    error: str = ""
    deleted: float = 0.0


class Workspace:
    """The folder of all jobs, which one server has to itself."""

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._jobs = self.path / "jobs"
        try:
            self._jobs.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(f"cannot write to {path}: {error.strerror}. Choose another --workspace.") from error

    def locked(self):
        """A context in which no other server works in the folder. Raises :class:`OutputError`."""
        return locked(self.path, "server")

    def folder(self, job: Job | str) -> Path:
        """The folder of a job."""
        return self._jobs / (job if isinstance(job, str) else job.id)

    def new_folder(self) -> tuple[str, Path]:
        """A fresh id and its folder, with an empty ``input``. It is no job yet."""
        identifier = time.strftime("%Y%m%d-%H%M%S-") + secrets.token_hex(4)
        (self.folder(identifier) / "input").mkdir(parents=True)
        return identifier, self.folder(identifier)

    def drop(self, identifier: str) -> None:
        """Remove a folder that never became a job."""
        shutil.rmtree(self.folder(identifier), ignore_errors=True)

    def get(self, identifier: str) -> Job | None:
        """The job of an id, None if there is none."""
        if not _ID.fullmatch(identifier):
            return None
        data = read_json(self.folder(identifier) / "job.json")
        known = {field.name for field in fields(Job)}
        try:
            return Job(**{name: value for name, value in data.items() if name in known}) if data else None
        except TypeError:
            return None

    def save(self, job: Job) -> Job:
        """Write how a job stands; returns it."""
        write_text(self.folder(job) / "job.json", json.dumps(asdict(job), indent=1) + "\n")
        return job

    def change(self, job: Job, **changes: Any) -> Job:
        """Save and return the job with some fields changed."""
        return self.save(replace(job, **changes))

    def jobs(self, deleted: bool = False) -> Iterator[Job]:
        """All jobs, the newest first."""
        for folder in sorted(self._jobs.iterdir(), reverse=True):
            if (job := self.get(folder.name)) and (deleted or not job.deleted):
                yield job

    def purge(self, now: float) -> None:
        """Remove the jobs that were deleted long ago, and folders in which an upload ended half-way."""
        for folder in self._jobs.iterdir():
            job = self.get(folder.name)
            if (job and job.deleted and now - job.deleted > KEPT_DELETED) or not (folder / "job.json").exists():
                shutil.rmtree(folder, ignore_errors=True)

    def copy(self, job: Job) -> Job:
        """A new job of the same files and draft; large files are shared where the disk can do that."""
        identifier, folder = self.new_folder()
        source = self.folder(job)
        shutil.copytree(source / "input", folder / "input", dirs_exist_ok=True, copy_function=_link)
        for name in ("model.glb", "analysis.json", "draft.json"):
            with suppress(FileNotFoundError):
                _link(source / name, folder / name)
        return self.save(Job(identifier, job.name, job.model, time.time()))


def default_path() -> Path:
    """Where the data of programs belong on this system."""
    if given := os.environ.get("GENMF_WORKSPACE"):
        return Path(given)
    if sys.platform == "darwin":
        base = Path.home() / "Library" / "Application Support"
    elif sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    else:
        base = Path(os.environ.get("XDG_DATA_HOME") or Path.home() / ".local" / "share")
    return base / "genmf_mi"


def read_json(path: Path) -> dict[str, Any]:
    """The object in a file, empty if there is none or it is damaged."""
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    return data if isinstance(data, dict) else {}


def _link(source: str | Path, target: str | Path) -> None:
    try:
        os.link(source, target)
    except OSError as error:
        if isinstance(error, FileNotFoundError):
            raise
        shutil.copy2(source, target)

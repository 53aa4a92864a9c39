"""One job after the other, and what becomes of each."""

from __future__ import annotations

import asyncio
import time
from contextlib import suppress
from typing import Any

from genmf_mi.core.errors import GenmfError
from genmf_mi.pipeline.run_folder import CHECKPOINT, METRICS, PREVIEW, STOP
from genmf_mi.ui import options, processes
from genmf_mi.ui.workspace import CANCELLED, FAILED, FINISHED, QUEUED, READY, RUNNING, Job, Workspace, read_json

MAX_ATTEMPTS = 3
"""So often a job is started again where its process was gone when the server came back."""
TICK = 0.15
"""Seconds between two looks at a process."""
DIED = "the work ended unexpectedly, perhaps for want of memory. Continue it, or ask for a smaller part or the draft."


class Conflict(GenmfError):
    """What was asked for does not go with the state of the job."""


class Queue:
    """Starts the processes of the jobs that wait, one at a time."""

    def __init__(self, workspace: Workspace) -> None:
        self.workspace, self._wake = workspace, asyncio.Event()

    async def work(self) -> None:
        """Work until cancelled. Processes go on without us: the next server finds them."""
        self.workspace.purge(time.time())
        while True:
            self._wake.clear()
            try:
                if job := self._next():
                    await self._carry_out(job)
                    continue
            except (OSError, GenmfError):  # a full disk; what is asked for next says so
                await asyncio.sleep(1.0)
                continue
            await self._wake.wait()

    def start(self, job: Job, settings: dict[str, Any], regions: bool) -> Job:
        """Put a job at the end of the queue. Raises :class:`Conflict`, or :class:`ConfigError` for its settings."""
        if job.state != READY:
            raise Conflict("this job was started already. Copy it to change its settings.")
        options.configured(settings)
        return self._enqueue(job, settings=settings, regions=regions)

    def resume(self, job: Job) -> Job:
        """Continue a job that was cancelled, has failed, or was ended early. Raises :class:`Conflict`."""
        if not (job.state in (CANCELLED, FAILED) or job.kept):
            raise Conflict("there is nothing to continue.")
        if job.settings is None:
            raise Conflict("this job was never started.")
        return self._enqueue(job, attempts=0)

    def cancel(self, job: Job) -> Job:
        """End a job that waits or runs, and keep what could be continued. Raises :class:`Conflict`."""
        if job.state == QUEUED:
            return self.workspace.change(job, state=CANCELLED if job.started else READY)
        if job.state != RUNNING:
            raise Conflict("this job does not run.")
        return self.workspace.change(job, cancel=True)

    def keep(self, job: Job) -> None:
        """Ask a job that refines to finish with what there is. Raises :class:`Conflict`."""
        if not self.can_keep(job):
            raise Conflict("there is nothing to keep yet.")
        (self.workspace.folder(job) / "run" / STOP).touch()

    def can_keep(self, job: Job) -> bool:
        """Whether a job has begun to refine, and can be asked to finish."""
        preview = self.workspace.folder(job) / "run" / PREVIEW
        return job.state == RUNNING and preview.exists() and preview.stat().st_mtime >= job.started

    def _enqueue(self, job: Job, **changes: Any) -> Job:
        job = self.workspace.change(
            job, state=QUEUED, queued=time.time(), cancel=False, kept=False, error="", ended=0.0, **changes
        )
        self._wake.set()
        return job

    def _next(self) -> Job | None:
        jobs = list(self.workspace.jobs())
        running = [job for job in jobs if job.state == RUNNING]
        waiting = sorted((job for job in jobs if job.state == QUEUED), key=lambda job: job.queued)
        return next(iter(running + waiting), None)

    async def _carry_out(self, job: Job) -> None:
        folder = self.workspace.folder(job)
        if job.state == RUNNING:
            process = processes.find(folder, job.pid)
            if process is None:  # it ended while there was no server
                self._settle(job, None)
                return
        else:
            try:
                job, process = self._started(job)
            except (OSError, GenmfError) as error:
                self.workspace.change(job, state=FAILED, ended=time.time(), error=str(error))
                return
        while await asyncio.to_thread(lambda: process.alive):
            current = self.workspace.get(job.id)
            if current is None or current.cancel:
                process.end()
            await asyncio.sleep(TICK)
        if current := self.workspace.get(job.id):
            self._settle(current, process.exit_code)

    def _started(self, job: Job) -> tuple[Job, processes.Process]:
        folder = self.workspace.folder(job)
        preset, up, config = options.configured(job.settings or {})
        words = ["refine", job.model, *options.arguments(preset, up, config), "--out", str((folder / "run").resolve())]
        if job.regions:
            words += ["--regions", str((folder / "regions.json").resolve())]
        words += ["--json-progress", "--resume" if (folder / "run" / CHECKPOINT).exists() else "--force"]
        log = folder / "log.txt"
        before = log.stat().st_size if log.exists() else 0
        process = processes.start(words, folder, folder / "input")
        job = self.workspace.change(
            job, state=RUNNING, pid=process.pid, started=time.time(), log_from=before, attempts=job.attempts + 1
        )
        return job, process

    def _settle(self, job: Job, exit_code: int | None) -> None:
        """Note how a job ended. Without the exit code its files tell."""
        folder = self.workspace.folder(job)
        metrics = folder / "run" / METRICS
        error = processes.last_error(folder / "log.txt", job.log_from)
        done = metrics.exists() and metrics.stat().st_mtime >= job.started - 1
        now = time.time()
        if done and exit_code in (0, None):
            kept = bool(read_json(metrics).get("interrupted"))
            self.workspace.change(job, state=FINISHED, ended=now, kept=kept, cancel=False)
        elif job.cancel:
            self.workspace.change(job, state=CANCELLED, ended=now, cancel=False)
        elif exit_code is None and not error and job.attempts < MAX_ATTEMPTS:
            self._enqueue(job)
        else:
            self.workspace.change(job, state=FAILED, ended=now, error=error or DIED)
        with suppress(OSError):
            (folder / "run" / STOP).unlink(missing_ok=True)

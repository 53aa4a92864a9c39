"""Asks the analysis, which runs in processes of its own (:mod:`genmf_mi.ui.analysis`)."""

from __future__ import annotations

import asyncio
import json
import os
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

from genmf_mi.core.files import write_text
from genmf_mi.ui import processes
from genmf_mi.ui.workspace import Workspace, read_json

READ_SECONDS, CHECK_SECONDS = 180.0, 900.0
"""After so long an analysis is given up."""
BROKE = "reading it took more memory or time than there is. Export it with fewer triangles or smaller textures."


class Worker:
    """A process that answers one request at a time; it is started when it is first asked, and after it has died.

    seconds: after which it is given up. low: whether it has less priority than the server.
    """

    def __init__(self, seconds: float, *, low: bool = False) -> None:
        self._seconds, self._low, self._turn = seconds, low, asyncio.Lock()
        self._process: asyncio.subprocess.Process | None = None

    async def warm_up(self) -> None:
        """Start the process, so that the first answer is quick."""
        async with self._turn:
            await self._started()

    async def ask(self, request: dict[str, Any]) -> bool:
        """Whether it answered; otherwise the process is gone."""
        async with self._turn:
            process = await self._started()
            assert process.stdin is not None and process.stdout is not None
            try:
                process.stdin.write(json.dumps(request).encode() + b"\n")
                await process.stdin.drain()
                return bool(await asyncio.wait_for(process.stdout.readline(), self._seconds))
            except (TimeoutError, OSError):
                await self.close()
                return False
            finally:
                if process.stdout.at_eof():
                    await self.close()

    async def close(self) -> None:
        """End the process."""
        if self._process is not None:
            with suppress(ProcessLookupError):
                self._process.kill()
            await self._process.wait()
            self._process = None

    async def _started(self) -> asyncio.subprocess.Process:
        if self._process is None or self._process.returncode is not None:
            self._process = await asyncio.create_subprocess_exec(
                sys.executable, "-m", "genmf_mi.ui.analysis",
                stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.DEVNULL,
                env={**os.environ, "PYTHONSAFEPATH": "1"}, start_new_session=True,
            )  # fmt: skip
            if self._low:
                processes.lower(self._process.pid)
        return self._process


class Analyser:
    """Analyses the models of jobs: reading them is answered at once, the check of the solid in its turn."""

    def __init__(self, workspace: Workspace) -> None:
        self._workspace = workspace
        self._reader, self._checker = Worker(READ_SECONDS), Worker(CHECK_SECONDS, low=True)
        self._tasks: set[asyncio.Task[None]] = set()
        self._asked: dict[str, str] = {}

    async def warm_up(self) -> None:
        """Start the reader, and analyse what an earlier server has left half done."""
        for job in list(self._workspace.jobs()):
            result = read_json(self._workspace.folder(job) / "analysis.json")
            if result.get("state") not in ("done", "failed"):
                self.analyse(job.id, job.model, result.get("up", "auto"))
        await self._reader.warm_up()

    def analyse(self, identifier: str, model: str, up: str) -> None:
        """Begin the analysis of a job; its ``analysis.json`` tells how far it is."""
        self._asked[identifier] = up
        folder = self._workspace.folder(identifier)
        write_text(folder / "analysis.json", json.dumps({"state": "reading", "up": up}))
        task = asyncio.create_task(self._analyse(identifier, folder, model, up))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def write_sample(self, folder: Path, name: str) -> bool:
        """Put a bundled sample into the ``input`` of a folder; whether there is one of that name."""
        request = {"task": "sample", "folder": str(folder.resolve()), "model": name, "up": "auto"}
        return await self._reader.ask(request) and (folder / "input" / f"{name}.glb").exists()

    async def close(self) -> None:
        """End all of it."""
        for task in self._tasks:
            task.cancel()
        await self._reader.close()
        await self._checker.close()

    async def _analyse(self, identifier: str, folder: Path, model: str, up: str) -> None:
        request = {"task": "read", "folder": str(folder.resolve()), "model": model, "up": up}
        if not await self._reader.ask(request):
            self._fail(folder, up, f"{Path(model).name}: {BROKE}")
            return
        if read_json(folder / "analysis.json").get("state") != "checking":
            return
        answered = await self._checker.ask(request | {"task": "check"})
        if self._asked.get(identifier) == up and not answered:
            # The model is there to look at; only what was to be said about it is missing
            result = read_json(folder / "analysis.json")
            write_text(folder / "analysis.json", json.dumps(result | {"state": "done"}))

    @staticmethod
    def _fail(folder: Path, up: str, error: str) -> None:
        write_text(folder / "analysis.json", json.dumps({"state": "failed", "up": up, "error": error}))

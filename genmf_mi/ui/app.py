"""The HTTP API and the page; docs/http_api.md describes it for those who call it."""

from __future__ import annotations

import asyncio
import json
import re
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from dataclasses import asdict
from importlib import resources
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, JSONResponse, Response, StreamingResponse
from starlette.routing import Route

from genmf_mi.core.errors import AssetError, ConfigError, GenmfError, OutputError
from genmf_mi.core.files import write_text
from genmf_mi.pipeline import run_folder
from genmf_mi.ui import uploads
from genmf_mi.ui.analyser import Analyser
from genmf_mi.ui.events import events
from genmf_mi.ui.guard import REPORT_POLICY, Guard, error
from genmf_mi.ui.options import UPS, options
from genmf_mi.ui.queue import Conflict, Queue
from genmf_mi.ui.regions import checked
from genmf_mi.ui.workspace import READY, RUNNING, Job, Workspace, read_json

VIEWER = ("shaders.js", "geometry.js", "gestures.js", "viewer.js", "packed.js")
"""Scripts that the page has in common with the report."""
SCRIPTS = (
    "app.js", "api.js", "glb.js", "paint.js", "painting.js", "result.js", "running.js", "settings.js", "texts.js",
    "zip.js",
)  # fmt: skip
STATIC = {
    "": ("genmf_mi.ui", "static/index.html", "text/html"),
    "ui.css": ("genmf_mi.ui", "static/ui.css", "text/css"),
    **{name: ("genmf_mi.report", name, "text/javascript") for name in VIEWER},
    **{name: ("genmf_mi.ui", f"static/{name}", "text/javascript") for name in SCRIPTS},
    **{name: ("genmf_mi.ui", f"static/{name}", "application/json") for name in ("en.json", "de.json")},
}
"""All files of the page, by their address."""
MAX_JSON = 16 * 1024**2
"""Bytes of a request but for uploads."""
TYPES = {".3mf": "model/3mf", ".stl": "model/stl", ".glb": "model/gltf-binary", ".jsonl": "application/jsonl"}


class Missing(GenmfError):
    """There is no such job or file."""


class Api:
    """The handlers. They change jobs without waiting in between, so that no change of another is lost."""

    def __init__(self, workspace: Workspace) -> None:
        self.workspace, self.queue, self.analyser = workspace, Queue(workspace), Analyser(workspace)

    def routes(self) -> list[Route]:
        """All addresses."""
        job = "/api/jobs/{id}"
        return [
            Route("/api/options", self.options),
            Route("/api/jobs", self.list),
            Route("/api/jobs", self.upload, methods=["POST"]),
            Route("/api/samples/{name}", self.sample, methods=["POST"]),
            Route(job, self.get),
            Route(job, self.delete, methods=["DELETE"]),
            Route(f"{job}/restore", self.restore, methods=["POST"]),
            Route(f"{job}/draft", self.draft, methods=["GET"]),
            Route(f"{job}/draft", self.save_draft, methods=["PUT"]),
            Route(f"{job}/up", self.turn, methods=["POST"]),
            Route(f"{job}/start", self.start, methods=["POST"]),
            Route(f"{job}/cancel", self.cancel, methods=["POST"]),
            Route(f"{job}/keep", self.keep, methods=["POST"]),
            Route(f"{job}/resume", self.resume, methods=["POST"]),
            Route(f"{job}/copy", self.copy, methods=["POST"]),
            Route(f"{job}/events", self.events),
            Route(f"{job}/model.glb", self.model),
            Route(f"{job}/files/{{name}}", self.file),
            Route("/{name}", self.static),
            Route("/", self.static),
        ]

    async def options(self, request: Request) -> Response:
        return JSONResponse(options())

    async def list(self, request: Request) -> Response:
        return JSONResponse({"jobs": [self._described(job) for job in self.workspace.jobs()]})

    async def upload(self, request: Request) -> Response:
        """The body is the file, its name is in the query."""
        name = uploads.safe_name(request.query_params.get("name", ""))
        length = request.headers.get("content-length", "")
        if length.isdigit() and int(length) > uploads.MAX_BYTES:
            raise uploads.too_large()
        identifier, folder = self.workspace.new_folder()
        path = folder / "input" / name
        try:
            await uploads.receive(request.stream(), path)
            if path.suffix.lower() == ".zip":
                archive = path.rename(folder / "upload.zip")
                await asyncio.to_thread(uploads.unpack, archive, folder / "input")
                archive.unlink()
            model = uploads.find_model(folder / "input").relative_to(folder / "input")
            title = model.stem if path.suffix.lower() == ".zip" else path.stem
            job = self.workspace.save(Job(identifier, title, str(model), time.time()))
        except ClientDisconnect:
            self.workspace.drop(identifier)
            return Response(status_code=400)
        except (GenmfError, OSError):
            self.workspace.drop(identifier)
            raise
        self.analyser.analyse(identifier, job.model, "auto")
        return JSONResponse(self._described(job), status_code=201)

    async def sample(self, request: Request) -> Response:
        """A job of a bundled sample."""
        name = request.path_params["name"]
        if not re.fullmatch(r"[a-z]{1,20}", name):
            raise Missing("there is no such sample.")
        identifier, folder = self.workspace.new_folder()
        if not await self.analyser.write_sample(folder, name):
            self.workspace.drop(identifier)
            raise Missing(f"there is no sample {name}.")
        job = self.workspace.save(Job(identifier, name, f"{name}.glb", time.time()))
        self.analyser.analyse(identifier, job.model, "auto")
        return JSONResponse(self._described(job), status_code=201)

    async def get(self, request: Request) -> Response:
        return JSONResponse(self._described(self._job(request)))

    async def delete(self, request: Request) -> Response:
        job = self._job(request)
        if job.state == RUNNING:
            raise Conflict("this job runs. Cancel it first.")
        self.workspace.change(job, deleted=time.time(), state=READY if job.state == "queued" else job.state)
        return Response(status_code=204)

    async def restore(self, request: Request) -> Response:
        return self._answer(self.workspace.change(self._job(request, deleted=True), deleted=0.0))

    async def draft(self, request: Request) -> Response:
        return JSONResponse(read_json(self.workspace.folder(self._job(request)) / "draft.json"))

    async def save_draft(self, request: Request) -> Response:
        draft = await self._json(request)
        job = self._job(request)
        checked(draft.get("regions"))
        write_text(self.workspace.folder(job) / "draft.json", json.dumps(draft))
        return Response(status_code=204)

    async def turn(self, request: Request) -> Response:
        """Read the model again with another axis upwards."""
        up = (await self._json(request)).get("up", "auto")
        job = self._job(request)
        if up not in UPS:
            raise ConfigError(f"{up} is no axis that could point upwards: choose one of {', '.join(UPS)}.")
        if job.state != READY:
            raise Conflict("this job was started already. Copy it to turn its model.")
        self.analyser.analyse(job.id, job.model, up)
        return self._answer(job)

    async def start(self, request: Request) -> Response:
        wanted = await self._json(request)
        job = self._job(request)
        regions = checked(wanted.get("regions"))
        analysis = read_json(self.workspace.folder(job) / "analysis.json")
        if analysis.get("state") == "failed":
            raise AssetError(str(analysis.get("error")))
        if regions:
            write_text(self.workspace.folder(job) / "regions.json", json.dumps(regions))
        return self._answer(self.queue.start(job, wanted.get("settings", {}), bool(regions)))

    async def cancel(self, request: Request) -> Response:
        return self._answer(self.queue.cancel(self._job(request)))

    async def keep(self, request: Request) -> Response:
        job = self._job(request)
        self.queue.keep(job)
        return self._answer(job)

    async def resume(self, request: Request) -> Response:
        return self._answer(self.queue.resume(self._job(request)))

    async def copy(self, request: Request) -> Response:
        return JSONResponse(self._described(self.workspace.copy(self._job(request))), status_code=201)

    async def events(self, request: Request) -> Response:
        job = self._job(request)

        def describe() -> dict[str, Any] | None:
            current = self.workspace.get(job.id)
            return self._described(current) if current and not current.deleted else None

        last = request.headers.get("last-event-id", "")
        log = self.workspace.folder(job) / "events.jsonl"
        stream = events(describe, log, int(last) if last.isdigit() else 0)
        return StreamingResponse(stream, media_type="text/event-stream", headers={"X-Accel-Buffering": "no"})

    async def model(self, request: Request) -> Response:
        return self._file(self.workspace.folder(self._job(request)) / "model.glb")

    async def file(self, request: Request) -> Response:
        """A result. Only names that runs write are looked for, so that no other file can be asked for."""
        name = request.path_params["name"]
        if name not in run_folder.FILES or name == run_folder.CHECKPOINT:
            raise Missing("there is no such file.")
        job = self._job(request)
        response = self._file(self.workspace.folder(job) / "run" / name)
        if name == run_folder.REPORT:
            response.headers["Content-Security-Policy"] = REPORT_POLICY
        if "download" in request.query_params:
            shown = f"{uploads.safe_name(job.name)}-{name}"
            return self._file(Path(response.path), filename=shown)
        return response

    async def static(self, request: Request) -> Response:
        found = STATIC.get(request.path_params.get("name", ""))
        if found is None:
            raise Missing("there is nothing at this address.")
        package, name, kind = found
        text = resources.files(package).joinpath(name).read_text(encoding="utf-8")
        return Response(text, media_type=kind)

    def _job(self, request: Request, deleted: bool = False) -> Job:
        job = self.workspace.get(request.path_params["id"])
        if job is None or (job.deleted and not deleted):
            raise Missing("there is no such job; it may have been deleted.")
        return job

    async def _json(self, request: Request) -> dict[str, Any]:
        body = b""
        async for chunk in request.stream():
            body += chunk
            if len(body) > MAX_JSON:
                raise uploads.TooLargeError("the request is too large.")
        try:
            data = json.loads(body or b"{}")
        except (ValueError, RecursionError) as problem:
            raise ConfigError("the request is no JSON.") from problem
        if not isinstance(data, dict):
            raise ConfigError("the request must be a JSON object.")
        return data

    def _answer(self, job: Job) -> Response:
        return JSONResponse(self._described(job))

    def _described(self, job: Job) -> dict[str, Any]:
        """A job as clients see it: how it stands, what was found out about its model, and its files."""
        folder = self.workspace.folder(job)
        hidden = ("pid", "log_from", "attempts", "cancel", "deleted")
        run = folder / "run"
        names = [name for name in run_folder.FILES if name != run_folder.CHECKPOINT and (run / name).exists()]
        return {
            **{name: value for name, value in asdict(job).items() if name not in hidden},
            "cancelling": job.cancel,
            "can_continue": job.kept or (job.state in ("cancelled", "failed") and job.settings is not None),
            "can_keep": self.queue.can_keep(job),
            "stopping": (run / run_folder.STOP).exists(),
            "analysis": read_json(folder / "analysis.json"),
            "files": names,
            "preview": (run / run_folder.PREVIEW).stat().st_mtime if (run / run_folder.PREVIEW).exists() else 0,
        }

    @staticmethod
    def _file(path: Path, filename: str | None = None) -> FileResponse:
        if not path.is_file():
            raise Missing("there is no such file yet.")
        return FileResponse(path, media_type=TYPES.get(path.suffix), filename=filename)


def build(workspace: Workspace, host: str = "127.0.0.1", token: str | None = None) -> Starlette:
    """The application; it works off the queue while it is served."""
    api = Api(workspace)

    @asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        working = [asyncio.create_task(api.queue.work()), asyncio.create_task(api.analyser.warm_up())]
        yield
        for task in working:
            task.cancel()
            with suppress(asyncio.CancelledError):
                await task
        await api.analyser.close()

    return Starlette(
        routes=api.routes(),
        lifespan=lifespan,
        middleware=[Middleware(Guard, host=host, token=token)],  # pyright: ignore[reportArgumentType]
        exception_handlers={
            GenmfError: _explained,
            OSError: _explained_disk,
            404: _explained_status,
            405: _explained_status,
        },
    )


async def _explained(request: Request, problem: Exception) -> Response:
    """What was wrong, in words."""
    kinds: list[tuple[type[Exception], int, str]] = [
        (uploads.TooLargeError, 413, "too-large"),
        (Missing, 404, "missing"),
        (Conflict, 409, "conflict"),
        (AssetError, 422, "asset"),
        (ConfigError, 422, "setting"),
        (OutputError, 507, "storage"),
    ]
    status, code = next(((status, code) for kind, status, code in kinds if isinstance(problem, kind)), (400, "error"))
    return error(status, code, str(problem))


async def _explained_disk(request: Request, problem: Exception) -> Response:
    reason = getattr(problem, "strerror", None) or type(problem).__name__
    return error(507, "storage", f"the server cannot write or read its files: {reason}. Free some space.")


async def _explained_status(request: Request, problem: Exception) -> Response:
    status = getattr(problem, "status_code", 404)
    return error(status, "missing", "there is nothing at this address." if status == 404 else "not this way.")

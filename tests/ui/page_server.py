"""A server of the page in the test's own process, and what asks it."""

from __future__ import annotations

import http.client
import json
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import uvicorn

from genmf_mi.ui.app import build
from genmf_mi.ui.server import _listening
from genmf_mi.ui.workspace import Workspace


class Client:
    """Asks a server of the test."""

    def __init__(self, port: int, workspace: Path) -> None:
        self.port, self.workspace, self.base = port, workspace, f"http://127.0.0.1:{port}"

    def raw(
        self, method: str, path: str, body: bytes | None = None, headers: dict[str, str] | None = None
    ) -> tuple[int, dict[str, str], bytes]:
        """Status, headers and body of an answer."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=60)
        try:
            connection.request(method, path, body, headers or {})
            answer = connection.getresponse()
            return answer.status, {k.lower(): v for k, v in answer.getheaders()}, answer.read()
        finally:
            connection.close()

    def ask(self, method: str, path: str, json_body: Any = None, body: bytes | None = None) -> tuple[int, Any]:
        """Status and JSON of an answer of the API."""
        data = json.dumps(json_body).encode() if json_body is not None else body
        status, _, text = self.raw(method, f"/api/{path}", data)
        return status, json.loads(text) if text else None

    def upload(self, path: str | Path, wait: bool = True) -> dict[str, Any]:
        """The job of an uploaded file, once it has been looked at."""
        path = Path(path)
        status, job = self.ask("POST", f"jobs?name={path.name}", body=path.read_bytes())
        assert status == 201, job
        if not wait:
            return job
        return self.wait(job["id"], lambda job: job["analysis"]["state"] in ("done", "failed"))

    def start(self, job: dict[str, Any], **settings: Any) -> dict[str, Any]:
        status, started = self.ask("POST", f"jobs/{job['id']}/start", {"settings": settings})
        assert status == 200, started
        return started

    def wait(self, identifier: str, until: Callable[[dict], bool] | str, seconds: float = 90) -> dict[str, Any]:
        """The job when it has a state, or whatever else is waited for."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            status, job = self.ask("GET", f"jobs/{identifier}")
            if status == 200 and (job["state"] == until if isinstance(until, str) else until(job)):
                return job
            time.sleep(0.05)
        pytest.fail(f"waited in vain: {job}")


class Served:
    """The application in a thread of the test's process; ``stop`` leaves the processes of jobs alone."""

    def __init__(self, folder: Path, host: str = "127.0.0.1", token: str | None = None) -> None:
        listener = _listening("127.0.0.1", 0)
        config = uvicorn.Config(build(Workspace(folder), host, token), log_level="error", ws="none", lifespan="on")
        config.timeout_graceful_shutdown = 1
        self.server = uvicorn.Server(config)
        self.thread = threading.Thread(target=self.server.run, args=([listener],), daemon=True)
        self.thread.start()
        self.client = Client(listener.getsockname()[1], folder)
        while not self.server.started:
            time.sleep(0.01)

    def stop(self) -> None:
        self.server.should_exit = True
        self.thread.join(20)
        assert not self.thread.is_alive()

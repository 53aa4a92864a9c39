"""Serves the page until Ctrl-C."""

from __future__ import annotations

import secrets
import socket
import threading
import webbrowser
from contextlib import suppress
from pathlib import Path

from genmf_mi.core.errors import OutputError, SetupError
from genmf_mi.ui.guard import is_loopback
from genmf_mi.ui.workspace import Workspace, default_path

PORT = 8390
"""Where the page is, or the first free one of the next ten."""
INSTALL = "The page needs Starlette and uvicorn. Run `pip install 'genmf-mi[ui]'`."


def serve(
    workspace: str | Path | None = None,
    host: str = "127.0.0.1",
    port: int = PORT,
    token: str | None = None,
    browser: bool = True,
) -> None:
    """Serve the page and the API, and open a browser.

    Args:
        workspace: where the jobs are kept; None for the user's data folder.
        host: the address to listen on. Others than this machine need a ``token``; one is made up if none is given.
        port: where to listen; the next free one is taken if it is in use, and any if 0.

    Raises:
        SetupError: the extra ``ui`` is not installed.
        OutputError: the workspace cannot be written to, another server has it, or no port is free.
    """
    try:
        import uvicorn

        from genmf_mi.ui.app import build
    except ModuleNotFoundError as error:
        raise SetupError(INSTALL) from error
    if not is_loopback(host) and not token:
        token = secrets.token_urlsafe(18)
    place = Workspace(workspace or default_path())
    with place.locked(), _listening(host, port) as listener:
        address = _address(host, listener.getsockname()[1], token)
        print(f"genmf-mi ui: {address}\njobs are kept in {place.path}; stop with Ctrl-C", flush=True)
        if browser:
            threading.Timer(0.5, webbrowser.open, (address,)).start()
        config = uvicorn.Config(
            build(place, host, token), log_level="warning", access_log=False, server_header=False,
            proxy_headers=False, timeout_graceful_shutdown=1, ws="none",
        )  # fmt: skip
        with suppress(KeyboardInterrupt):
            uvicorn.Server(config).run([listener])


def _listening(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    for candidate in range(port, port + (10 if port else 1)):
        listener = socket.socket(family, socket.SOCK_STREAM)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind((host.strip("[]"), candidate))
            return listener
        except OSError as error:
            listener.close()
            reason = error.strerror
    raise OutputError(f"cannot listen on {host}, port {port}: {reason}. Choose another --port or --host.")


def _address(host: str, port: int, token: str | None) -> str:
    shown = {"0.0.0.0": socket.gethostname(), "::": socket.gethostname()}.get(host, host)
    shown = f"[{shown}]" if ":" in shown else shown
    return f"http://{shown}:{port}/" + (f"?token={token}" if token else "")

"""``genmf-mi ui``: the page for makers."""

from __future__ import annotations

from pathlib import Path

from genmf_mi.cli.arguments import call


def ui(
    workspace: Path | None = None,
    host: str = "127.0.0.1",
    port: int = 8390,
    token: str | None = None,
    no_browser: bool = False,
) -> int:
    """Open the page: drop a file, look at it, paint, start, compare, download. Needs the extra ui.

    Jobs run one after the other, and go on when the server is stopped and started again (docs/ui.md).

    Args:
        workspace: Folder in which the jobs are kept; in the user's data folder if not given.
        host: Address to listen on; others than this machine need the token that is printed.
        port: Port to listen on, or the next one that is free.
        token: What others must know to use the page; made up if not given.
        no_browser: Only print the address.
    """
    from genmf_mi.ui.server import serve

    serve(workspace, host, port, token, browser=not no_browser)
    return 0


def main(arguments: list[str]) -> int:
    """Read the arguments and serve."""
    return call(ui, "ui", arguments)

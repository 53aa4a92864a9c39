"""What happens to a job, as server-sent events that a browser takes up again by itself where it lost them."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

TICK, PING = 0.2, 15.0
"""Seconds between two looks at the files, and between two signs of life."""
_CHUNK = 1 << 18


async def events(describe: Callable[[], dict[str, Any] | None], log: Path, start: int) -> AsyncIterator[str]:
    """``job`` whenever the job has changed, and ``progress`` for each line that its process prints.

    The id of an event is the place in ``log`` up to which the lines were sent.

    Args:
        describe: how the job stands, None once it is gone, which ends the stream.
        start: the id of the last event that the client has.
    """
    known, place, spoken = None, start, time.monotonic()
    yield "retry: 1000\n\n"
    while True:
        current = describe()
        if current is None:
            yield "event: gone\ndata: {}\n\n"
            return
        if log.exists() and log.stat().st_size < place:
            place = 0
        lines, place = await asyncio.to_thread(_lines, log, place)
        sent = False
        if lines:
            yield f"id: {place}\nevent: progress\ndata: [{','.join(lines)}]\n\n"
            sent = True
        if current != known:
            yield f"id: {place}\nevent: job\ndata: {json.dumps(current)}\n\n"
            known, sent = current, True
        if sent:
            spoken = time.monotonic()
        elif time.monotonic() - spoken > PING:
            yield ": still there\n\n"
            spoken = time.monotonic()
        await asyncio.sleep(TICK)


def _lines(log: Path, place: int) -> tuple[list[str], int]:
    """The whole lines of JSON from a place in a file on, and the place after them."""
    try:
        with log.open("rb") as file:
            file.seek(place)
            data = file.read(_CHUNK)
    except OSError:
        return [], place
    end = data.rfind(b"\n") + 1
    lines = [line.decode("utf-8", "replace") for line in data[:end].splitlines()]
    return [line for line in lines if line.startswith("{") and line.endswith("}")], place + end

"""What the reading of one asset may do, and what it has taken so far.

The readers of all formats look here, so that the limits hold for a file as a whole and not for each of its parts.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field

import numpy as np

from genmf_mi.core.errors import AssetError

LARGEST_PIXELS, MOST_PIXELS = 8192 * 8192, 3 * 8192 * 8192
"""Of a picture, whose decoding takes up to fourteen bytes for each; and of all of an asset, which keep three."""
MOST_FACES = 20_000_000
"""Of an asset, copies counted each time that they are placed."""


@dataclass
class Reading:
    """One asset.

    anywhere: whether it may name files outside of its own folder.
    pictures: what is decoded already, by content; materials often share one. faces: how many are read.
    """

    anywhere: bool = False
    pictures: dict[bytes, np.ndarray] = field(default_factory=dict[bytes, np.ndarray])
    faces: int = 0

    def require_room(self, width: int, height: int, name: str) -> None:
        """Raise :class:`AssetError` for a picture that is too large, or one too many."""
        if width * height > LARGEST_PIXELS:
            raise AssetError(f"the texture {name} has {width} × {height} pixels. Scale it down to 8192 × 8192.")
        if width * height + sum(pixels.shape[0] * pixels.shape[1] for pixels in self.pictures.values()) > MOST_PIXELS:
            raise AssetError(f"the textures are too large together, from {name} on. Scale them down to 4096 × 4096.")

    def take_faces(self, count: int, where: object) -> None:
        """Count triangles. Raises :class:`AssetError` for more than :data:`MOST_FACES`."""
        self.faces += count
        if self.faces > MOST_FACES:
            raise AssetError(f"{where} has more than {MOST_FACES // 10**6} million triangles. Simplify it.")


_current: ContextVar[Reading | None] = ContextVar("reading", default=None)


def current() -> Reading:
    """Of the asset that is being read; one of its own where none is."""
    return _current.get() or Reading()


@contextmanager
def reading(*, anywhere: bool = False) -> Iterator[Reading]:
    """Read one asset inside."""
    token = _current.set(Reading(anywhere))
    try:
        yield current()
    finally:
        _current.reset(token)

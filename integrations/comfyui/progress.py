"""Progress of a refinement as ComfyUI shows it: its bar, with a picture of the part so far; its Cancel stops it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from comfy_api.latest import ComfyAPISync

from genmf_mi.core.progress import Progress

PICTURE = "preview.png"
"""What a run keeps in its folder while it lasts."""


class ComfyProgress(Progress):
    """Moves the bar of the node that runs.

    Args:
        folder: of the run, whose preview is shown whenever it is new.
    """

    def __init__(self, folder: Path) -> None:
        self._api, self._picture, self._shown = ComfyAPISync(), folder / PICTURE, 0

    def stage(self, name: str) -> None:
        self._stop_if_cancelled()
        print(f"[genmf] {name}")

    def advance(self, done: float, total: float, values: Mapping[str, float] | None = None) -> None:
        self._stop_if_cancelled()
        self._api.execution.set_progress(value=done, max_value=total, preview_image=self._new_picture())

    def warn(self, message: str) -> None:
        print(f"[genmf] warning: {message}")

    def _new_picture(self):
        if not self._picture.is_file() or self._picture.stat().st_mtime_ns == self._shown:
            return None
        from PIL import Image

        self._shown = self._picture.stat().st_mtime_ns
        with Image.open(self._picture) as image:
            return image.convert("RGB")

    @staticmethod
    def _stop_if_cancelled() -> None:
        from comfy import model_management

        model_management.throw_exception_if_processing_interrupted()

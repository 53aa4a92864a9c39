"""One item in a worker: fetched, refined or continued, and put where it belongs."""

from __future__ import annotations

import time
import traceback
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from genmf_mi.assets.sources import load as load_asset
from genmf_mi.batch import storage
from genmf_mi.batch.journal import cause_of
from genmf_mi.batch.keys import named_files
from genmf_mi.batch.record import ItemRecord, worker_name
from genmf_mi.batch.task import Task
from genmf_mi.core.errors import ConfigError, GenmfError, OutputError
from genmf_mi.core.progress import Progress
from genmf_mi.pipeline.refinement import refine
from genmf_mi.pipeline.run_folder import (
    BEFORE_AFTER,
    CHECKPOINT,
    CONFIG,
    FILES,
    HISTORY,
    METRICS,
    REPLACEMENT,
    RunFolder,
)

THUMBNAIL = "thumbnail.jpg"
THUMBNAIL_SIZE = 640, 282
"""Pixels; the title and the first view of the picture."""
UPLOAD_EVERY = 30.0
"""Seconds between two uploads of a checkpoint."""
STATE = (CONFIG, HISTORY, CHECKPOINT)
"""What a run needs to be continued, in the order in which it is safe to copy."""
BUSY, PATIENCE = "is writing into", 60.0
"""Of the error of a folder that another process has, and seconds to wait for one that is being killed."""


class ItemProgress(Progress):
    """Keeps the warnings; for a folder behind a URL, uploads each new checkpoint."""

    def __init__(self, path: Path, folder: str) -> None:
        self.warnings: list[str] = []
        self._path, self._folder, self._uploaded, self._at = path, folder, 0, time.monotonic()

    def warn(self, message: str) -> None:
        self.warnings.append(message)

    def advance(self, done: float, total: float, values: Mapping[str, float] | None = None) -> None:
        checkpoint = self._path / CHECKPOINT
        if not storage.is_url(self._folder) or not checkpoint.exists() or time.monotonic() - self._at < UPLOAD_EVERY:
            return
        if (changed := checkpoint.stat().st_mtime_ns) != self._uploaded:
            for name in STATE:
                storage.upload(self._path / name, storage.join(self._folder, name))
            self._uploaded, self._at = changed, time.monotonic()


def execute(task: Task) -> dict[str, Any]:
    """Do an item; whatever goes wrong becomes part of its outcome.

    Returns:
        the fields of :class:`genmf_mi.batch.journal.BatchOutcome` that are known here.
    """
    start, cpu = time.perf_counter(), time.process_time()
    warnings: list[str] = []
    try:
        state, metrics = _executed(task, warnings)
        outcome: dict[str, Any] = {"state": state, "scores": scores(metrics)}
    except GenmfError as error:
        outcome = {"state": "failed", "cause": cause_of(error), "error": str(error)}
    except OSError as error:
        outcome = {"state": "failed", "cause": "output", "error": f"{error}. Check permissions and space on the disk."}
    except Exception as error:  # a defect of this package must not stop the batch either
        text = "".join(traceback.format_exception(error)[-6:])
        outcome = {"state": "failed", "cause": "defect", "error": f"{type(error).__name__}: {error}\n{text}"}
    outcome |= {
        "seconds": round(time.perf_counter() - start, 2),
        "cpu_seconds": round(time.process_time() - cpu, 2),
        "worker": worker_name(),
        "warnings": warnings,
    }
    return outcome


def _executed(task: Task, warnings: list[str]) -> tuple[str, dict[str, Any]]:
    """State and metrics. Raises as :func:`genmf_mi.refine`."""
    known = () if task.force else (*STATE, METRICS)
    with storage.workspace(task.folder, known) as path, TemporaryDirectory(prefix="genmf-") as fetched:
        progress = ItemProgress(path, task.folder)
        try:
            folder = RunFolder(path)
            metrics = None if task.force else _finished(folder, task, progress)
            if metrics is not None:
                return "skipped", metrics
            resume, local = _resumable(folder, task, progress), _fetched(task, Path(fetched))
            metrics = _refined(local, path, progress, resume=resume)
            ItemRecord.load(task.folder).claim(task)  # not before: until now a run that is replaced is still there
            _write_thumbnail(path)
            if storage.is_url(task.folder):
                _upload(path, task.folder)
            return "refined", metrics
        finally:
            warnings += progress.warnings


def _finished(folder: RunFolder, task: Task, progress: Progress) -> dict[str, Any] | None:
    """The metrics of a complete run of this very work; None if there is none, or it is damaged.

    Raises:
        ConfigError: a complete run of something else.
    """
    record = ItemRecord.load(task.folder)
    try:
        metrics = folder.metrics()
        if metrics is None:
            return None
        if record.key == task.key and record.key:
            folder.settings()  # that they can be read
            return metrics
        folder.require(task.work.config.to_dict())  # says which setting is another
    except OutputError as error:
        _redo(folder, record, error, progress)
        return None
    if record.key:
        raise ConfigError(
            f"the run in {folder.path} was made of another content of the asset, or with other options such as "
            "--verify or --scene. Use another --out, or --force to replace it."
        )
    if task.work.verify and "stress" not in metrics:
        raise ConfigError(
            f"the run in {folder.path} was made without --verify. Leave it out, use another --out, or --force."
        )
    return metrics


def _redo(folder: RunFolder, record: ItemRecord, error: OutputError, progress: Progress) -> None:
    """Say that a run is damaged, and make room for it to be done again.

    Raises:
        OutputError: the folder may be somebody else's.
    """
    if not (record.key or folder.is_ours):
        raise error
    progress.warn(f"{str(error).partition('. ')[0]}: the item is done again")
    for name in FILES:  # without settings beside them they would count as somebody else's
        (folder.path / name).unlink(missing_ok=True)
    RunFolder(folder.path / REPLACEMENT).discard()


def _resumable(folder: RunFolder, task: Task, progress: Progress) -> bool:
    """Whether there is a run to go on with; a damaged one is said and done again."""
    if task.force or not folder.interrupted:
        return False
    grown = RunFolder(folder.path / REPLACEMENT)
    interrupted = grown if grown.interrupted else folder
    try:
        interrupted.settings()
        interrupted.load()
    except OutputError as error:
        _redo(folder, ItemRecord.load(task.folder), error, progress)
        return False
    return True


def _refined(task: Task, path: Path, progress: Progress, *, resume: bool) -> dict[str, Any]:
    """The metrics; waits for a process that is about to end and still has the folder."""
    keywords, deadline = task.work.keywords(), time.monotonic() + PATIENCE
    while True:
        try:
            result = refine(
                task.asset, task.work.config, out=path, force=not resume, resume=resume, progress=progress, **keywords
            )
            return result.metrics
        except OutputError as error:
            if BUSY not in str(error) or time.monotonic() > deadline:
                raise
            time.sleep(0.5)


def _fetched(task: Task, folder: Path) -> Task:
    """The task with everything that it reads on this machine."""
    work = task.work.with_painted(lambda setting, file: str(_fetch(file, folder / setting)))
    textured = _fetch(work.textured, folder / "textured") if work.textured else None
    scene = _fetch(work.scene, folder / "scene") if work.scene else None
    references: list[str] = []
    for i, reference in enumerate(work.references):
        picture, _, turn = reference.rpartition("@")
        references.append(f"{_fetch(picture, folder / f'reference{i}')}@{turn}")
    asset = task.asset
    if isinstance(asset, str) and storage.is_url(asset):
        asset = load_asset(_fetch(asset, folder / "asset"), textured, work.up, files_anywhere=work.files_anywhere)
        work, textured = replace(work, up=None, files_anywhere=False), None
    return replace(task, asset=asset, work=replace(work, textured=textured, scene=scene, references=tuple(references)))


def _fetch(place: str, folder: Path) -> str:
    """A path of what is at ``place``, with the files that it names. Raises :class:`storage.UrlError`."""
    if not storage.is_url(place):
        return str(storage.path_of(place))
    home, name = storage.split(place)
    wanted, path = [name], folder / name
    while wanted:
        current = wanted.pop()
        target = folder / current
        if ".." in Path(current).parts or Path(current).is_absolute() or target.exists():
            continue
        if not storage.download(storage.join(home, current), target):
            if current == name:
                raise storage.UrlError(f"there is nothing at {place}. Check the spelling.")
            continue  # the reader says what is missing
        inside = Path(current).parent
        wanted += [(inside / other).as_posix() for other in named_files(target)]
    return str(path)


def _write_thumbnail(path: Path) -> None:
    """A small ``before_after.png`` for the gallery."""
    from PIL import Image

    from genmf_mi.core.files import atomic

    if not (path / BEFORE_AFTER).exists():
        return
    with Image.open(path / BEFORE_AFTER) as image:
        width, height = THUMBNAIL_SIZE
        top = min(image.height, round(image.width * height / width))
        small = image.convert("RGB").crop((0, 0, image.width, top))
    small.thumbnail(THUMBNAIL_SIZE)
    with atomic(path / THUMBNAIL) as temporary:
        small.save(temporary, quality=80)


def _upload(path: Path, folder: str) -> None:
    """All files of a run, the one that says that it is complete last."""
    files = sorted(file for file in path.rglob("*") if file.is_file() and not file.name.startswith("."))
    for file in [*(one for one in files if one.name != METRICS), path / METRICS]:
        storage.upload(file, storage.join(folder, *file.relative_to(path).parts))
    storage.remove(storage.join(folder, CHECKPOINT))


def scores(metrics: Mapping[str, Any]) -> dict[str, float]:
    """What gallery and table show of ``metrics.json``."""
    found: dict[str, float] = {}
    for name, path in SCORES.items():
        value: Any = metrics
        for step in path:
            value = value.get(step) if isinstance(value, Mapping) else None
        if isinstance(value, int | float):
            found[name] = round(float(value), 5)
    return found


SCORES = {
    "lpips_before": ("before", "lpips_alex"),
    "lpips_displacement": ("displacement", "lpips_alex"),
    "lpips": ("after", "lpips_alex"),
    "ssim_before": ("before", "ssim"),
    "ssim": ("after", "ssim"),
    "g_ssim": ("after", "g_ssim"),
    "lpips_unseen": ("unseen", "after", "lpips_alex"),
    "relief_mean_mm": ("relief_mm", "mean"),
    "relief_max_mm": ("relief_mm", "max"),
    "watertight": ("solid", "watertight"),
    "self_intersections": ("solid", "self_intersections"),
}
"""Where the figures are in ``metrics.json``."""

"""The folder of a run: what is written when, and how an interrupted run is continued."""

from __future__ import annotations

import json
import shutil
from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, fields, is_dataclass, replace
from hashlib import sha256
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from genmf_mi.core.config import MASK_FILE, REGIONS_FILE, RefineConfig
from genmf_mi.core.errors import ConfigError, OutputError
from genmf_mi.core.files import claim_folder, sweep, write_bytes, write_text, written
from genmf_mi.core.regions import MASK_IMAGES, MASK_MESHES
from genmf_mi.fabrication.files import COLOURED_GLB, PRINT_3MF, PRINT_STL

if TYPE_CHECKING:
    from genmf_mi.pipeline.checkpoint import Checkpoint

CONFIG, HISTORY, CHECKPOINT, METRICS = "config.yaml", "metrics.jsonl", "checkpoint.pt", "metrics.json"
PREVIEW, BEFORE_AFTER, REPORT, AS_PRINTED = "preview.png", "before_after.png", "report.html", "as_printed.png"
MASKS = tuple(MASK_FILE + suffix for suffix in MASK_IMAGES + MASK_MESHES)
STOP = "stop"
"""A file of this name, put into the folder by anybody, asks the run to finish with what there is."""
FILES = (
    REGIONS_FILE, *MASKS,
    CONFIG, HISTORY, CHECKPOINT, METRICS, PREVIEW, BEFORE_AFTER, REPORT, AS_PRINTED, PRINT_3MF, PRINT_STL, COLOURED_GLB,
)  # fmt: skip
EXR = "exr"
"""All that a run writes into its folder, and a folder of more."""
REPLACEMENT, COMPLETE, CONTENTS = ".replacement", ".complete", "contents.json"
"""Below the folder of a run that is replaced: where the new one grows, what that is called once it is complete, and the
list of its files that it then holds."""


@dataclass(frozen=True)
class RunFolder:
    """The output folder of one refinement.

    ``config.yaml`` is there from the start, ``metrics.jsonl`` holds a line per iteration, ``checkpoint.pt`` holds the
    state of the optimisation, ``preview.png`` shows the part so far; both are removed once the run is complete.
    ``metrics.json`` comes last.

    A run that replaces another one grows in a folder below and takes its place when it is complete; until then the old
    one is whole.

    path: where the files are. replaces: the folder of the run that this one is to replace, or None.
    started_with: what ``config.yaml`` holds, once the folder is open.
    """

    path: Path
    replaces: Path | None = None
    started_with: dict[str, Any] | None = None

    @classmethod
    def open(
        cls,
        path: str | Path,
        asset: str,
        config: RefineConfig,
        inputs: Mapping[str, str] | None = None,
        *,
        copies: Mapping[str, bytes] | None = None,
        force: bool,
        resume: bool,
    ) -> RunFolder:
        """Claim a folder for a new run, or an interrupted one for its continuation.

        inputs: what the run depends on besides its settings, as :func:`fingerprint` by name.
        copies: of files that the run keeps beside its settings, by their names.

        Raises:
            OutputError: the folder holds a run already, or files of somebody else that the run would replace, cannot be
                written to, or has nothing to resume.
            ConfigError: the run to resume was started with other settings, another asset or other inputs.
        """
        import yaml

        folder = cls(Path(path))
        folder.settle()
        ours = folder.is_ours
        if ours:
            (folder.path / STOP).unlink(missing_ok=True)
        grown = cls(folder.path / REPLACEMENT, folder.path)
        if not grown.interrupted:
            grown.discard()
        settings: dict[str, Any] = {"asset": asset, **config.to_dict(), "inputs": dict(inputs or {})}
        if grown.interrupted and not (force or resume):
            raise OutputError(
                f"{path} holds a run, and another one that was to replace it and was interrupted. Use --resume to "
                "continue that, --force to start it again, or another --out."
            )
        if resume and grown.interrupted:
            sweep(grown.path, FILES)
            grown.require(settings)
            return replace(grown, started_with=settings)
        # Settings alone are of a run that failed before it had anything to lose
        claim_folder(
            path, "run", finished=(METRICS,), interrupted=(CHECKPOINT,), force=force, resume=resume,
            foreign=() if ours else (*FILES, STOP),
        )  # fmt: skip
        sweep(path, FILES)
        if resume:
            folder.require(settings)
            return replace(folder, started_with=settings)
        if any((folder.path / name).exists() for name in (METRICS, CHECKPOINT)):
            grown.discard()
            folder = grown
        write_text(folder.path / CONFIG, yaml.safe_dump(settings, sort_keys=False))
        for name in (HISTORY, CHECKPOINT, METRICS, PREVIEW, REGIONS_FILE, *MASKS):
            (folder.path / name).unlink(missing_ok=True)
        for name, content in (copies or {}).items():
            write_bytes(folder.path / name, content)
        return replace(folder, started_with=settings)

    @contextmanager
    def resumable(self) -> Generator[None]:
        """Have errors inside say that what there is can be continued, if it can."""
        try:
            yield
        except OutputError as error:
            if not self.interrupted:
                raise
            raise OutputError(f"{error} Then continue with --resume.") from error

    def _keep_settings(self) -> None:
        """Write ``config.yaml`` again if somebody has deleted the folder: without it nobody knows whose the rest is."""
        import yaml

        if self.started_with is not None and not (self.path / CONFIG).exists():
            write_text(self.path / CONFIG, yaml.safe_dump(self.started_with, sort_keys=False))

    def discard(self) -> None:
        """Remove what a run has written here; other files stay. Raises :class:`OutputError`."""
        if not self.path.is_dir():
            return
        sweep(self.path, FILES)
        with written(self.path):
            for name in (*FILES, CONTENTS):
                (self.path / name).unlink(missing_ok=True)
            shutil.rmtree(self.path / EXR, ignore_errors=True)
            with suppress(OSError):  # there is something else in it
                self.path.rmdir()

    def settle(self) -> None:
        """Let a replacement that is complete take its place; again where that was cut short.

        Raises:
            OutputError: a file cannot be moved, or the list of them is damaged.
        """
        complete = self.path / COMPLETE
        if not complete.is_dir():
            return
        try:
            names = json.loads((complete / CONTENTS).read_text(encoding="utf-8"))
            places = [PurePosixPath(name) for name in names]
        except FileNotFoundError:  # another process was faster
            return
        except (OSError, ValueError, TypeError, RecursionError) as error:
            raise OutputError(f"{complete / CONTENTS} is damaged. Delete {complete}.") from error
        if not all(str(place) in FILES or (place.parts[:1] == (EXR,) and ".." not in place.parts) for place in places):
            raise OutputError(f"{complete / CONTENTS} is damaged. Delete {complete}.")
        with written(self.path):
            for name in set(FILES) - set(names):
                (self.path / name).unlink(missing_ok=True)
            for place in places:  # the metrics last
                (self.path / place).parent.mkdir(parents=True, exist_ok=True)
                with suppress(FileNotFoundError):  # it was moved before
                    (complete / place).replace(self.path / place)
        RunFolder(complete).discard()

    @property
    def is_ours(self) -> bool:
        """Whether a run has left its settings in the folder."""
        try:
            return {"asset", "size_mm", "iterations"} <= set(self.settings())
        except OutputError:
            return False

    @property
    def interrupted(self) -> bool:
        """Whether there is a run to resume."""
        return any((folder / CHECKPOINT).exists() for folder in (self.path, self.path / REPLACEMENT))

    @property
    def stop_requested(self) -> bool:
        """Whether somebody wants the run to finish with what there is."""
        return any((folder / STOP).exists() for folder in (self.path, self.replaces) if folder is not None)

    def require(self, settings: dict[str, Any]) -> None:
        """Raise :class:`ConfigError` if the run was started with other ``settings``; the device does not count."""
        before, settings = self.settings(), dict(settings)
        inputs: dict[str, str] = settings.pop("inputs", {})
        inputs_before: dict[str, str] = before.get("inputs") or {}
        changed = sorted(k for k in settings if before.get(k) != settings[k] and k != "device")
        changed += [f"content of the {k}" for k in inputs if inputs_before.get(k, inputs[k]) != inputs[k]]
        if changed:
            raise ConfigError(
                f"the run in {self.path} was started with another {', '.join(changed)}. Use the same, another --out, "
                "or --force to replace it."
            )

    def settings(self) -> dict[str, Any]:
        """The contents of ``config.yaml``. Raises :class:`OutputError` if they are not settings."""
        import yaml

        try:
            settings = yaml.safe_load((self.path / CONFIG).read_text(encoding="utf-8"))
        except (OSError, ValueError, RecursionError, yaml.YAMLError) as error:
            raise OutputError(f"{self.path / CONFIG} cannot be read. Start again with --force.") from error
        if not isinstance(settings, dict):
            raise OutputError(f"{self.path / CONFIG} holds no settings. Start again with --force.")
        return cast(dict[str, Any], settings)

    def metrics(self) -> dict[str, Any] | None:
        """The contents of ``metrics.json`` of a complete run, None if there is none.

        Raises:
            OutputError: damaged.
        """
        self.settle()
        if self.interrupted or not (self.path / METRICS).exists():
            return None
        try:
            metrics = json.loads((self.path / METRICS).read_text(encoding="utf-8"))
        except (OSError, ValueError, RecursionError) as error:
            raise OutputError(f"{self.path / METRICS} cannot be read. Start again with --force.") from error
        if not isinstance(metrics, dict):
            raise OutputError(f"{self.path / METRICS} holds no metrics. Start again with --force.")
        metrics = cast(dict[str, Any], metrics)
        return None if metrics.get("interrupted") else metrics

    def save(self, checkpoint: Checkpoint, history: Sequence[dict[str, Any]]) -> None:
        """Replace the history, then the checkpoint, so that a crash in between leaves a history that is too long,
        never one that is too short. Raises :class:`OutputError`."""
        self._keep_settings()
        write_text(self.path / HISTORY, "".join(json.dumps(line) + "\n" for line in history))
        checkpoint.save(self.path / CHECKPOINT)

    def load(self) -> tuple[Checkpoint, list[dict[str, Any]]]:
        """The checkpoint and the history up to its iteration.

        Raises:
            OutputError: either is damaged, or they do not belong together.
        """
        from genmf_mi.pipeline.checkpoint import Checkpoint

        checkpoint = Checkpoint.load(self.path / CHECKPOINT)
        try:
            lines = (self.path / HISTORY).read_text(encoding="utf-8").splitlines()[: checkpoint.iteration]
            history = [json.loads(line) for line in lines]
            complete = [line["iteration"] for line in history] == list(range(checkpoint.iteration))
        except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
            raise OutputError(f"{self.path / HISTORY} is damaged. Start again with --force.") from error
        if not complete:
            raise OutputError(f"{self.path / HISTORY} does not match the checkpoint. Start again with --force.")
        return checkpoint, history

    def finish(self, metrics: dict[str, Any]) -> None:
        """Write ``metrics.json``, and remove the preview, a request to stop and, unless the run was interrupted, the
        checkpoint. A complete run then takes the place of the one that it replaces. Raises :class:`OutputError`."""
        self._keep_settings()
        write_text(self.path / METRICS, json.dumps(metrics, indent=2) + "\n")
        for name in (PREVIEW, STOP):
            (self.path / name).unlink(missing_ok=True)
        if metrics.get("interrupted"):
            return
        if self.replaces is None:
            (self.path / CHECKPOINT).unlink(missing_ok=True)
        else:
            inside = (self.path / EXR).rglob("*")
            exr = [file.relative_to(self.path).as_posix() for file in inside if file.is_file()]
            present = {name for name in FILES if (self.path / name).exists()} - {CHECKPOINT, METRICS}
            files = [*exr, *(name for name in FILES if name in present), METRICS]
            write_text(self.path / CONTENTS, json.dumps(files))
            with written(self.replaces):
                self.path.rename(self.replaces / COMPLETE)  # from here on nothing can be lost
            RunFolder(self.replaces).settle()

    def home(self, *, interrupted: bool) -> Path:
        """Where the files are after :meth:`finish`."""
        return self.path if self.replaces is None or interrupted else self.replaces


def fingerprint(*things: Any) -> str:
    """A hash of the content of files, arrays, and of dataclasses of them. Names and places of files do not count, nor
    do files that are missing."""
    content = sha256()
    _add(content, things)
    return content.hexdigest()[:16]


def _add(content: Any, thing: Any) -> None:
    if isinstance(thing, np.ndarray):
        array = cast("np.ndarray[Any, np.dtype[Any]]", thing)
        content.update(f"{array.dtype}{array.shape}".encode() + np.ascontiguousarray(array).tobytes())
    elif isinstance(thing, Path):
        content.update(thing.read_bytes() if thing.is_file() else b"")
    elif is_dataclass(thing):
        for field in fields(thing):
            if field.name not in ("name", "source", "report", "notes", "groups", "group"):
                _add(content, getattr(thing, field.name))
    elif isinstance(thing, (tuple, list)):
        for one in cast("Sequence[Any]", thing):
            _add(content, one)
    else:
        content.update(repr(thing).encode())

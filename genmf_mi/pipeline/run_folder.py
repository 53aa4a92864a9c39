"""A run's folder: what is written when, and how an interrupted run is picked up again."""

from __future__ import annotations

import json
import zlib
from dataclasses import dataclass
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from genmf_mi.core.config import RefineConfig
from genmf_mi.core.errors import ConfigError, OutputError
from genmf_mi.core.files import atomic, write_text

CONFIG, HISTORY, CHECKPOINT, METRICS = "config.yaml", "metrics.jsonl", "checkpoint.npz", "metrics.json"


@dataclass(frozen=True)
class Run:
    """The output folder of one refinement.

    ``config.yaml`` is there from the start, ``metrics.jsonl`` holds a line per iteration, ``checkpoint.npz`` holds
    the optimiser's state and goes once the run is complete, ``metrics.json`` comes last.
    """

    folder: Path

    @classmethod
    def open(cls, folder: str | Path, asset: str, config: RefineConfig, *, force: bool, resume: bool) -> Run:
        """Claim a folder for a new run, or an interrupted one for its continuation.

        Raises:
            OutputError: the folder holds a run already, cannot be written to, or has nothing to resume.
            ConfigError: the run to resume was started with other settings or another asset.
        """
        run, settings = cls(Path(folder)), {"asset": asset, **config.to_dict()}
        try:
            interrupted, finished = ((run.folder / name).exists() for name in (CHECKPOINT, METRICS))
        except OSError as error:
            raise OutputError(f"cannot read {folder}: {error.strerror}. Choose another --out.") from error
        if resume:
            if not interrupted:
                raise OutputError(f"{folder} holds no interrupted run. Start one without --resume.")
            run.require(settings)
            return run
        # Settings alone are of a run that failed before it had anything to lose
        if (interrupted or finished) and not force:
            state, hint = ("an interrupted", " --resume to continue it,") if interrupted else ("a finished", "")
            raise OutputError(f"{folder} holds {state} run. Use{hint} --force to replace it, or another --out.")
        import yaml

        write_text(run.folder / CONFIG, yaml.safe_dump(settings, sort_keys=False))
        for name in (HISTORY, CHECKPOINT, METRICS):
            (run.folder / name).unlink(missing_ok=True)
        return run

    def require(self, settings: dict) -> None:
        """Raises :class:`ConfigError` if the run was started with others; where it computes does not count."""
        before = self.settings()
        changed = sorted(k for k in settings if before.get(k) != settings[k] and k != "device")
        if changed:
            raise ConfigError(
                f"the run in {self.folder} was started with another {', '.join(changed)}. Use the same, or --force."
            )

    def settings(self) -> dict:
        """The contents of ``config.yaml``. Raises :class:`OutputError` if they are not settings."""
        import yaml

        try:
            settings = yaml.safe_load((self.folder / CONFIG).read_text(encoding="utf-8"))
        except (OSError, ValueError, yaml.YAMLError) as error:
            raise OutputError(f"{self.folder / CONFIG} cannot be read. Start again with --force.") from error
        if not isinstance(settings, dict):
            raise OutputError(f"{self.folder / CONFIG} holds no settings. Start again with --force.")
        return settings

    def save(self, state: dict[str, np.ndarray], history: list[dict]) -> None:
        """Replace the history, then the checkpoint, so that a crash in between leaves a history that is too long,
        never one that is too short. Raises :class:`OutputError`."""
        write_text(self.folder / HISTORY, _lines(history))
        with atomic(self.folder / CHECKPOINT) as path:
            np.savez(path, **state)

    def load(self) -> tuple[dict[str, np.ndarray], list[dict]]:
        """The checkpoint's state and the history up to its iteration.

        Raises:
            OutputError: either is damaged, or they do not go together.
        """
        try:
            with open(self.folder / CHECKPOINT, "rb") as handle, np.load(handle) as data:
                state = dict(data)
            count = int(state["iteration"])
            lines = (self.folder / HISTORY).read_text(encoding="utf-8").splitlines()[:count]
            history = [json.loads(line) for line in lines]
            complete = [line["iteration"] for line in history] == list(range(count))
        except (OSError, ValueError, KeyError, TypeError, EOFError, BadZipFile, zlib.error) as error:
            raise OutputError(f"the checkpoint in {self.folder} is damaged. Start again with --force.") from error
        if not complete:
            raise OutputError(f"{self.folder / HISTORY} does not go with the checkpoint. Start again with --force.")
        return state, history

    def finish(self, metrics: dict) -> None:
        """Write ``metrics.json`` and drop the checkpoint, unless the run was interrupted."""
        write_text(self.folder / METRICS, json.dumps(metrics, indent=2) + "\n")
        if not metrics.get("interrupted"):
            (self.folder / CHECKPOINT).unlink(missing_ok=True)


def _lines(history: list[dict]) -> str:
    return "".join(json.dumps(line) + "\n" for line in history)

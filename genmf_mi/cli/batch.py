"""``genmf-mi batch``: many assets, one after the other; one that fails is recorded and does not stop the rest."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from shlex import join, split
from typing import TYPE_CHECKING

from genmf_mi.cli.arguments import call
from genmf_mi.cli.refine import RefineArguments, parse_text
from genmf_mi.core.errors import ConfigError, GenmfError
from genmf_mi.core.files import write_text

if TYPE_CHECKING:
    from genmf_mi.pipeline.run_folder import RunFolder

SUMMARY = "batch.json"
REGIONS_SUFFIX = ".regions.json"
"""In place of an asset's suffix: what was painted on it."""


def batch(assets: tuple[Path, ...], out: Path = Path("runs"), arguments: str = "", force: bool = False) -> int:
    """Refine many assets, each in a process of its own, so that one that fails does not stop the others.

    Run it again to continue after an interruption: finished runs are skipped, interrupted ones resumed. A finished run
    of other settings counts as failed and is left alone. ``batch.json`` in the output folder lists the outcomes. Exit
    code 1 if any failed. Strokes in bus.regions.json beside bus.glb are its --regions, unless --arguments name some.

    Args:
        assets: Files, or names of bundled samples.
        out: Folder for the runs, one subfolder per asset.
        arguments: More arguments for `genmf-mi refine`, as in --arguments="--size-mm 80 --preset draft".
        force: Replace the runs in the folder.
    """
    from genmf_mi.cli.progress import TerminalProgress

    if not assets:
        raise ConfigError("name at least one asset.")
    names = [asset.stem for asset in assets]
    if len(set(names)) < len(names):
        raise ConfigError("two assets have the same file name, and so would share a folder. Rename one.")
    chosen = parse_text(str(assets[0]), arguments, "batch")
    outcomes: dict[str, dict] = {}
    with TerminalProgress() as progress:
        for i, (name, asset) in enumerate(zip(names, assets, strict=True)):
            progress.stage(name)
            progress.advance(i, len(assets))
            words = split(arguments)
            beside = asset.with_name(asset.stem + REGIONS_SUFFIX)
            if chosen.config.regions is None and beside.is_file():
                words += ["--regions", str(beside)]
            own = parse_text(str(asset), join(words), "batch")
            outcome = outcomes[name] = _refine(asset, out / name, own, words, force)
            write_text(out / SUMMARY, json.dumps(outcomes, indent=2) + "\n")
            print(f"{name}: {outcome['state']} {outcome.get('error', '')}".rstrip())
            for warning in outcome.get("warnings", ()):
                progress.warn(f"{name}: {warning}")
    return int(any(outcome["state"] == "failed" for outcome in outcomes.values()))


def _refine(asset: Path, path: Path, chosen: RefineArguments, words: list[str], force: bool) -> dict:
    """Refine one asset into the folder ``path`` unless that is done; its outcome.

    words: the arguments that were parsed to ``chosen``, for the process.
    """
    from genmf_mi.pipeline.run_folder import METRICS, RunFolder

    folder, metrics = RunFolder(path), path / METRICS
    try:
        if not force and _is_finished(folder, chosen):
            return {"state": "skipped", "metrics": str(metrics)}
        mode = "--resume" if folder.interrupted and not force else "--force"
    except (GenmfError, OSError) as error:
        return {"state": "failed", "error": f"error: {error}"}
    command = [sys.executable, "-m", "genmf_mi", "refine", str(asset), "--out", str(path), "--quiet", mode, *words]
    process = subprocess.run(command, capture_output=True, text=True, encoding="utf-8", errors="replace", check=False)
    lines = [line for line in process.stderr.splitlines() if line.strip()]
    warnings = [line.removeprefix("warning: ") for line in lines if line.startswith("warning: ")]
    outcome: dict = {"warnings": warnings} if warnings else {}
    if process.returncode == 0 and metrics.exists():
        return {"state": "refined", "metrics": str(metrics), **outcome}
    last = lines[-1] if lines else f"exit code {process.returncode}"
    return {"state": "failed", "error": next((line for line in lines if line.startswith("error:")), last), **outcome}


def _is_finished(folder: RunFolder, chosen: RefineArguments) -> bool:
    """Whether ``folder`` holds a complete run of the settings in ``chosen``.

    Raises:
        ConfigError: a complete run of other settings. OutputError: a damaged one.
    """
    from genmf_mi.pipeline import regions

    metrics = folder.metrics()
    if metrics is None:
        return False
    folder.require({**chosen.config.to_dict(), "inputs": regions.fingerprints(regions.copies(chosen.config))})
    if chosen.verify and "stress" not in metrics:
        raise ConfigError(
            f"the run in {folder.path} was made without --verify. Leave it out, use another --out, or --force."
        )
    return True


def main(arguments: list[str]) -> int:
    """Read the arguments and run the batch."""
    return call(batch, "batch", arguments)

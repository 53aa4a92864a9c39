"""Many assets, one after the other: what is done is skipped, what fails is recorded, nothing stops the rest."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import tyro

from genmf_mi.core.errors import ConfigError
from genmf_mi.core.files import write_text

SUMMARY = "batch.json"


def batch(
    assets: tyro.conf.Positional[tuple[Path, ...]],
    out: Path = Path("runs"),
    arguments: str = "",
) -> int:
    """Refine many assets, each in a process of its own, so that one that fails takes nothing with it.

    Run it again to go on after an interruption: finished runs are skipped, interrupted ones resumed. ``batch.json``
    in the output folder lists what became of each. Exit code 1 if any failed.

    Args:
        assets: Files, or names of bundled samples.
        out: Folder for the runs, one subfolder per asset.
        arguments: More arguments for `genmf-mi refine`, as in --arguments="--size-mm 80 --preset draft".
    """
    from shlex import split

    from rich.progress import Progress

    if not assets:
        raise ConfigError("name at least one asset.")
    names = [asset.stem for asset in assets]
    if len(set(names)) < len(names):
        raise ConfigError("two assets have the same file name, and so would share a folder. Rename one.")
    outcomes: dict[str, dict] = {}
    with Progress() as progress:
        task = progress.add_task("refining", total=len(assets))
        for name, asset in zip(names, assets, strict=True):
            progress.update(task, description=name)
            outcomes[name] = _one(asset, out / name, split(arguments))
            write_text(out / SUMMARY, json.dumps(outcomes, indent=2) + "\n")
            progress.console.print(f"{name}: {outcomes[name]['state']} {outcomes[name].get('error', '')}".rstrip())
            progress.advance(task)
    return int(any(outcome["state"] == "failed" for outcome in outcomes.values()))


def _one(asset: Path, folder: Path, arguments: list[str]) -> dict:
    """Refine one asset into ``folder`` unless it is done; its outcome."""
    metrics = folder / "metrics.json"
    if metrics.exists() and not json.loads(metrics.read_text(encoding="utf-8")).get("interrupted"):
        return {"state": "skipped", "metrics": str(metrics)}
    going_on = ["--resume"] if (folder / "checkpoint.npz").exists() else ["--force"]
    command = [sys.executable, "-m", "genmf_mi", "refine", str(asset), "--out", str(folder), "--quiet"]
    done = subprocess.run([*command, *going_on, *arguments], capture_output=True, text=True, check=False)
    if done.returncode == 0 and metrics.exists():
        return {"state": "refined", "metrics": str(metrics)}
    last = [line for line in done.stderr.splitlines() if line.strip()]
    error = next(
        (line for line in last if line.startswith("error:")), last[-1] if last else f"exit code {done.returncode}"
    )
    return {"state": "failed", "error": error}

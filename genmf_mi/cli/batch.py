"""``genmf-mi batch``: many assets on one machine, a part of them on each of many, or all of them on a cluster."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Literal

from genmf_mi.cli.arguments import call
from genmf_mi.cli.refine import RefineArguments, parse_text
from genmf_mi.core.errors import ConfigError

if TYPE_CHECKING:
    from genmf_mi.batch.journal import BatchOutcome


def batch(
    assets: tuple[str, ...],
    out: str = "runs",
    arguments: str = "",
    engine: Literal["local", "ray", "inline"] = "local",
    workers: int = 0,
    threads: int = 0,
    shard: str = "",
    address: str = "auto",
    time_limit_s: float = 4 * 3600.0,
    memory_gb: float = 0.0,
    crashes: int = 3,
    retries: int = 1,
    recycle_items: int = 100,
    recycle_growth_mb: float = 1000.0,
    retry_failed: bool = False,
    force: bool = False,
) -> int:
    """Refine many assets, several at a time; one that fails does not stop the others.

    Run it again to continue after an interruption: finished runs are skipped, interrupted ones resumed from their
    checkpoints. A finished run of other settings counts as failed and is left alone. `outcomes.jsonl` in the output
    folder lists the outcomes as they come; `genmf-mi merge` makes a table and a gallery of them. Exit code 1 if any
    failed. Strokes in bus.regions.json beside bus.glb are its --regions, unless others are named. From a laptop to a
    cluster: docs/batch.md.

    Args:
        assets: Files, URLs (s3://, gs:// ...), names of bundled samples, folders, patterns such as "scans/*.glb", and
            manifests: .csv or .jsonl with the columns asset, name, and settings of `genmf-mi refine`.
        out: Folder or URL for the runs, one subfolder per asset.
        arguments: More arguments for `genmf-mi refine`, as in --arguments="--size-mm 80 --preset draft".
        engine: local: worker processes on this machine. ray: tasks on a Ray cluster, needs genmf-mi[ray]. inline: in
            this process, for debugging.
        workers: Worker processes of this machine; 0: as many as cores, memory and GPUs hold.
        threads: Threads of each worker; 0: the cores are shared out, with Ray 1.
        shard: 3/64 does the third of 64 parts of the batch; auto takes part and number from a job array of Slurm or
            AWS Batch.
        address: The Ray cluster: auto for the one that this machine belongs to, HOST:PORT, or ray://HOST:PORT.
        time_limit_s: Seconds that an asset may take; 0 sets no limit.
        memory_gb: Memory that a worker may hold; 0: its share of this machine.
        crashes: Crashes of a worker after which its asset is put aside.
        retries: Attempts after failures that may pass, as of a network or a full disk.
        recycle_items: Assets after which a worker is replaced.
        recycle_growth_mb: Growth of a worker since its first asset after which it is replaced; 0 sets no limit.
        retry_failed: Try assets that failed by themselves or were put aside again.
        force: Replace the runs in the folder.
    """
    if not assets:
        raise ConfigError("name at least one asset, folder, pattern or manifest.")
    chosen = parse_text(assets[0], arguments, "batch")
    from genmf_mi.batch.arguments import items_of
    from genmf_mi.batch.engine import run_batch
    from genmf_mi.batch.shards import in_array
    from genmf_mi.batch.task import Limits
    from genmf_mi.cli.progress import TerminalProgress

    if not shard and in_array():
        print(
            "warning: this is one task of a job array, and does all of the batch: --shard auto does its part",
            file=sys.stderr,
        )
    limits = Limits(time_limit_s, memory_gb, crashes, retries, recycle_items, recycle_growth_mb)
    counts: dict[str, int] = {}
    with TerminalProgress() as progress:
        outcomes = run_batch(
            items_of(assets), chosen.config, out=out, executor=engine, workers=workers, threads=threads, shard=shard,
            address=address, limits=limits, force=force, retry_failed=retry_failed, progress=progress,
            **_options(chosen),
        )  # fmt: skip
        for outcome in outcomes:
            counts[outcome.state] = counts.get(outcome.state, 0) + 1
            print(line(outcome), flush=True)
            for warning in outcome.warnings if outcome.state != "skipped" else ():
                progress.warn(f"{outcome.name}: {warning}")
    print(", ".join(f"{count} {state}" for state, count in counts.items()))
    return int(bool(counts.get("failed") or counts.get("quarantined")))


def line(outcome: BatchOutcome) -> str:
    """An outcome in one line."""
    if outcome.of:
        return f"{outcome.name}: duplicate of {outcome.of}"
    if not outcome.good:
        return f"{outcome.name}: {outcome.state} error: {outcome.error.splitlines()[0] if outcome.error else ''}"
    seconds = f" in {outcome.seconds:.0f} s" if outcome.state == "refined" else ""
    return f"{outcome.name}: {outcome.state}{seconds}"


def _options(chosen: RefineArguments) -> dict[str, object]:
    return {
        **chosen.options(),
        "verify": chosen.verify,
        "print_check": chosen.print_check,
        "slicer": chosen.slicer,
    }


def main(arguments: list[str]) -> int:
    """Read the arguments and run the batch."""
    return call(batch, "batch", arguments)

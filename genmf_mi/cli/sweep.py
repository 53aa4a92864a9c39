"""``genmf-mi sweep``: what a lower stress costs in appearance."""

from __future__ import annotations

from pathlib import Path

from genmf_mi.cli.arguments import call
from genmf_mi.core.errors import ConfigError


def sweep(
    asset: str,
    stress_weight: str = "0,0.3,1,3,10",
    out: Path | None = None,
    arguments: str = "",
    force: bool = False,
) -> int:
    """Refine an asset with several weights of the stress, and simulate each result by finite elements.

    Run it again to continue after an interruption: finished runs are skipped, interrupted ones resumed. Writes
    sweep.json and sweep.png, the trade-off between appearance and stress, and a folder for each run.

    Args:
        asset: A file, or the name of a bundled sample.
        stress_weight: Weights to try, with commas between. 0 stands for no stress stage and is always among them.
        out: Folder for the results; runs/NAME-sweep if not given.
        arguments: More arguments for `genmf-mi refine`, as in --arguments="--size-mm 80 --preset draft".
        force: Replace the runs in the folder.
    """
    from genmf_mi.cli.refine import SHOWN, parse_text

    try:
        weights = tuple(map(float, stress_weight.split(",")))
    except ValueError:
        raise ConfigError(f"--stress-weight takes numbers such as 0,1,3, not {stress_weight!r}.") from None
    chosen = parse_text(asset, arguments, "sweep")
    from genmf_mi.cli.progress import TerminalProgress
    from genmf_mi.cli.tables import print_table
    from genmf_mi.pipeline import sweep as pipeline
    from genmf_mi.report.sweep import sweep_table

    out = out or Path("runs") / f"{Path(asset).stem}-sweep"
    with TerminalProgress(quiet=chosen.quiet, shown=SHOWN) as progress:
        result = pipeline.sweep(
            asset, weights, chosen.config, out=out, force=force, progress=progress, **chosen.options()
        )
    print_table(f"{result['asset']}: appearance, and thermal stress by finite elements in MPa", sweep_table(result))
    print(f"numbers in {out / pipeline.SUMMARY}, picture in {out / pipeline.PICTURE}")
    return 0


def main(arguments: list[str]) -> int:
    """Read the arguments and run the sweep."""
    return call(sweep, "sweep", arguments)

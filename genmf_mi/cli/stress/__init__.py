"""``genmf-mi stress simulate | compare | dataset | train | predict``, a module each with a function of that name."""

from __future__ import annotations

from importlib import import_module

import tyro

COMMANDS = ("simulate", "compare", "dataset", "train", "predict")


def main(arguments: list[str]) -> int:
    """Run the command that the arguments name; returns the exit code."""
    functions = {name: getattr(import_module(f"{__name__}.{name}"), name) for name in COMMANDS}
    tyro.extras.subcommand_cli_from_dict(functions, prog="genmf-mi stress", args=arguments)
    return 0

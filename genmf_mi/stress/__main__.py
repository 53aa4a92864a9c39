"""``python -m genmf_mi.stress``: the stress commands on their own."""

from __future__ import annotations

import sys

import tyro

from genmf_mi.errors import GenmfError
from genmf_mi.stress.commands import COMMANDS

if __name__ == "__main__":
    try:
        tyro.extras.subcommand_cli_from_dict(COMMANDS, prog="python -m genmf_mi.stress")
    except GenmfError as error:
        print(error, file=sys.stderr)
        sys.exit(error.exit_code)

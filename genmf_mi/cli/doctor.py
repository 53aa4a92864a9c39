"""``genmf-mi doctor``: what of the installation works, what is missing, and how to install it.

``make setup`` ends with ``genmf-mi doctor --fix``, so it must run where LLVM and the LPIPS weights are missing.
"""

from __future__ import annotations

import json as json_module
import os
import shutil
import subprocess
import sys
from dataclasses import asdict

from genmf_mi.cli.arguments import call
from genmf_mi.cli.checks import Check, examine, last_line
from genmf_mi.core import llvm
from genmf_mi.core.errors import SetupError

INSTALLABLE = {"LLVM": " ".join(llvm.DEBIAN_PACKAGES), "LPIPS weights": "the LPIPS weights (64 MB)"}
"""Checks that ``--fix`` can turn into ok, and what it installs for that."""


def doctor(json: bool = False, fix: bool = False) -> int:
    """Check the installation: what works, what is missing, how to install it. Exit code 0 if `genmf-mi refine` can run.

    Args:
        json: Print a JSON object {"ok": bool, "checks": [{name, status, detail, fix}]} instead of the table.
        fix: First install what is missing of the LPIPS weights and LLVM (the latter on Debian and Ubuntu, as root or
            where sudo asks for no password).
    """
    checks, problems = examine(), []
    missing = [check.name for check in checks if check.status == "missing" and check.name in INSTALLABLE]
    if fix and missing:
        problems = install(missing, quiet=json)
        checks = examine()
    ok = all(check.status != "missing" for check in checks)
    if json:
        print(json_module.dumps({"ok": ok, "checks": [asdict(check) for check in checks]}, indent=2))
    else:
        _print(checks)
    for problem in problems:
        print(f"error: {problem}", file=sys.stderr)
    return 0 if ok else 1


def install_llvm() -> None:
    """Install LLVM from the distribution.

    Raises:
        SetupError: no apt-get, no rights, or the installation failed; the message holds the command to run by hand.
    """
    environment = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
    prefix = [] if getattr(os, "geteuid", lambda: 1)() == 0 else ["sudo", "-n"]  # Windows has no such function

    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        command = [*prefix, *arguments]
        return subprocess.run(command, capture_output=True, text=True, env=environment, check=False)

    allowed = not prefix or (shutil.which("sudo") and run("true").returncode == 0)
    if not (shutil.which("apt-get") and allowed):
        raise SetupError(f"LLVM 17 or newer is missing, and cannot be installed from here. {llvm.advice()}")
    run("apt-get", "update", "-qq")  # may fail without harm where the lists exist
    process = run("apt-get", "install", "-qq", "-y", "--no-install-recommends", *llvm.DEBIAN_PACKAGES)
    if process.returncode:
        raise SetupError(
            f"apt-get could not install {llvm.DEBIAN_PACKAGES[0]}: {last_line(process.stderr)} {llvm.advice()}"
        )


def install_weights() -> None:
    """Fetch the LPIPS weights. Raises :class:`SetupError`."""
    try:
        from genmf_mi.losses.lpips_conversion import install
    except ImportError as error:
        raise SetupError(f"the LPIPS weights cannot be installed yet: {error}. Run `make setup`.") from error
    install()


def install(names: list[str], *, quiet: bool) -> list[str]:
    """Install some of :data:`INSTALLABLE`; why any of that failed, a sentence each."""
    steps = {"LLVM": install_llvm, "LPIPS weights": install_weights}
    problems = []
    for name in names:
        if not quiet:
            print(f"Installing {INSTALLABLE[name]} ...", flush=True)
        try:
            steps[name]()
        except SetupError as error:
            problems.append(str(error))
    return problems


def _print(checks: list[Check]) -> None:
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    colour = {"ok": "green", "missing": "red", "optional": "yellow"}
    table = Table(box=None, pad_edge=False)
    for heading in ("", "status", "details", "fix"):
        table.add_column(heading, overflow="fold")
    for check in checks:
        table.add_row(check.name, f"[{colour[check.status]}]{check.status}[/]", escape(check.detail), escape(check.fix))
    Console().print(table)


def main(arguments: list[str]) -> int:
    """Read the arguments and examine."""
    return call(doctor, "doctor", arguments)

"""``genmf-mi doctor``: what the machine has, what it lacks, and how to mend it."""

from __future__ import annotations

import argparse
import importlib
import json as json_module
import os
import shutil
import subprocess
import sys
import tempfile
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path
from typing import Literal

from genmf_mi.core.errors import GenmfError, SetupError
from genmf_mi.losses import lpips_weights as weights
from genmf_mi.losses.lpips_conversion import install
from genmf_mi.render import variant

LLVM_PACKAGE = "libllvm19"
_FREE_BYTES = 500e6
_PROBE_SECONDS = 120


@dataclass(frozen=True)
class Check:
    """One line of the report. ``missing`` stops the main job, ``optional`` does not; ``mend`` says what to do."""

    name: str
    status: Literal["ok", "missing", "optional"]
    found: str
    mend: str = ""


def doctor(json: bool = False, fix: bool = False) -> int:
    """Report what is there and what is missing; return 0 if ``genmf-mi refine`` can run, else 1.

    json: print a JSON object ``{"ok": bool, "checks": [{name, status, found, mend}]}`` in place of the table.
    fix: first install what is missing of the LPIPS weights and LLVM (the latter on Debian and Ubuntu, as root or where
        sudo asks no password).
    """
    problem = ""
    checks = examine()
    if fix:
        try:
            if _mend({check.name for check in checks if check.status == "missing"}, quiet=json):
                checks = examine()
        except SetupError as error:
            problem = str(error)
    ok = all(check.status != "missing" for check in checks)
    if json:
        print(json_module.dumps({"ok": ok, "checks": [asdict(check) for check in checks]}, indent=2))
    else:
        _print(checks)
    if problem:
        print(f"error: {problem}", file=sys.stderr)
    return 0 if ok else 1


def examine() -> list[Check]:
    """All checks, in the order in which a fresh machine would be set up."""
    return [
        check_python(),
        check_package("mitsuba", "Mitsuba"),
        check_package("drjit", "Dr.Jit"),
        check_package("torch", "PyTorch"),
        check_package("pymeshlab", "PyMeshLab"),
        *check_rendering(),
        check_weights(),
        check_disk(Path.cwd(), "Output folder"),
        check_disk(Path(tempfile.gettempdir()), "Temporary folder"),
    ]


def check_python() -> Check:
    return Check("Python", "ok", f"{'.'.join(map(str, sys.version_info[:3]))} ({sys.executable})")


def check_package(module: str, name: str) -> Check:
    """Whether the module can be imported, which needs more than that it is installed: shared libraries too."""
    try:
        version = metadata.version(module)
        importlib.import_module(module)
    except metadata.PackageNotFoundError:
        return Check(name, "missing", "not installed", "Run `make setup`, or `pip install genmf-mi`.")
    except (ImportError, OSError) as error:
        return Check(name, "missing", f"{version}, but: {error}", "Install the library that the message names.")
    return Check(name, "ok", version)


def check_llvm(version: tuple[int, ...] | None, path: str = "") -> Check:
    """Whether Dr.Jit can work with this LLVM; it aborts the process with LLVM 15 and 16."""
    if version is None or version[0] < 0:  # -1 is Dr.Jit's word for none, and for LLVM 14 and older
        return Check("LLVM", "missing", "none that Dr.Jit can load", _llvm_advice())
    found = ".".join(map(str, version)) + (f" ({path})" if path else "")
    if version < variant.OLDEST_LLVM:
        return Check("LLVM", "missing", f"{found}, too old for Dr.Jit", _llvm_advice())
    return Check("LLVM", "ok", found)


def check_rendering() -> list[Check]:
    """LLVM, a picture rendered with it, and the GPU, from a process of its own: there Dr.Jit may abort and complain."""
    command = [sys.executable, "-c", "from genmf_mi.cli.doctor import _probe; _probe()"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=_PROBE_SECONDS, check=False)
    except subprocess.TimeoutExpired:
        return [Check("Rendering", "missing", f"no picture after {_PROBE_SECONDS} s", "Look for a stuck process.")]
    lines = done.stdout.splitlines()
    if not lines:
        return [Check("Rendering", "missing", _last_line(done.stderr), "Mend what is listed above first.")]
    report = json_module.loads(lines[0])
    llvm = check_llvm(tuple(report["llvm"]) if report["llvm"] else None, report["llvm_path"])
    if done.returncode == 0:
        rendering = Check("Rendering", "ok", variant.CPU)
    elif llvm.status == "missing":
        rendering = Check("Rendering", "missing", f"{variant.CPU} needs LLVM", "Mend LLVM first.")
    else:
        found = f"{variant.CPU} failed: {_last_line(done.stderr)}"
        rendering = Check("Rendering", "missing", found, "Run `make setup`: it installs the tested versions.")
    if report["gpu"]:
        return [llvm, rendering, Check("GPU", "ok", f"{report['gpu']} ({variant.CUDA})")]
    return [llvm, rendering, Check("GPU", "optional", "none that both PyTorch and Dr.Jit see", "The CPU does, slower.")]


def check_weights() -> Check:
    if lacking := weights.missing():
        found = f"no {' and '.join(lacking)} in {weights.folder()}"
        return Check("LPIPS weights", "missing", found, weights.HOW_TO_INSTALL)
    return Check("LPIPS weights", "ok", str(weights.folder()))


def check_disk(folder: Path, name: str) -> Check:
    if not os.access(folder, os.W_OK):
        return Check(name, "missing", f"{folder} is not writable", "Go to a folder of yours, or choose another --out.")
    free = shutil.disk_usage(folder).free
    found = f"{folder}, {free / 1e9:.1f} GB free"
    if free < _FREE_BYTES:
        return Check(name, "missing", found, "Free some space: a run writes up to 500 MB.")
    return Check(name, "ok", found)


def install_llvm() -> None:
    """Install LLVM from the distribution.

    Raises:
        SetupError: no apt-get, no rights, or the installation failed; the message holds the command to run by hand.
    """
    environment = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
    prefix = [] if os.geteuid() == 0 else ["sudo", "-n"]

    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        command = [*prefix, *arguments]
        return subprocess.run(command, capture_output=True, text=True, env=environment, check=False)

    allowed = not prefix or (shutil.which("sudo") and run("true").returncode == 0)
    if not (shutil.which("apt-get") and allowed):
        raise SetupError(f"LLVM 17 or newer is missing, and cannot be installed from here. {_llvm_advice()}")
    run("apt-get", "update", "-qq")  # may fail without harm if the lists are there
    done = run("apt-get", "install", "-qq", "-y", "--no-install-recommends", LLVM_PACKAGE)
    if done.returncode:
        raise SetupError(f"apt-get could not install {LLVM_PACKAGE}: {_last_line(done.stderr)} {_llvm_advice()}")


def _mend(missing: set[str], *, quiet: bool) -> bool:
    """Install what is missing and can be installed; whether anything was."""
    steps = {
        "LLVM": (f"Installing {LLVM_PACKAGE} ...", install_llvm),
        "LPIPS weights": ("Fetching the LPIPS weights (64 MB) ...", install),
    }
    for name in missing & set(steps):
        message, step = steps[name]
        if not quiet:
            print(message, flush=True)
        step()
    return bool(missing & set(steps))


def _probe() -> None:
    """Print what Dr.Jit sees as JSON, then render a picture of 8 x 8 pixels; exit status 0 says that it worked."""
    import mitsuba as mi
    import torch

    gpu = torch.cuda.get_device_name() if variant.cuda_available() else ""
    report = {"llvm": variant.llvm_version(), "llvm_path": _llvm_path(), "gpu": gpu}
    print(json_module.dumps(report), flush=True)
    variant.use("cpu")
    film = {"type": "hdrfilm", "width": 8, "height": 8, "pixel_format": "luminance"}
    sensor = {"type": "perspective", "film": film}
    scene = {"type": "scene", "integrator": {"type": "depth"}, "sensor": sensor, "sphere": {"type": "sphere"}}
    mi.render(mi.load_dict(scene), spp=1).numpy()


def _llvm_path() -> str:
    try:
        maps = Path("/proc/self/maps").read_text(encoding="utf-8")
    except OSError:
        return os.environ.get("DRJIT_LIBLLVM_PATH", "")
    return next((line.split()[-1] for line in maps.splitlines() if "libLLVM" in line), "")


def _llvm_advice() -> str:
    if shutil.which("apt-get"):
        return f"Run `sudo apt-get install {LLVM_PACKAGE}`."
    if sys.platform == "darwin":
        return "Run `brew install llvm`."
    return "Install LLVM 17 or newer, or point DRJIT_LIBLLVM_PATH to its shared library."


def _last_line(text: str) -> str:
    return text.strip().splitlines()[-1] if text.strip() else "no message"


def _print(checks: list[Check]) -> None:
    from rich.console import Console
    from rich.table import Table

    colour = {"ok": "green", "missing": "red", "optional": "yellow"}
    table = Table(box=None, pad_edge=False)
    for heading in ("", "status", "found", "to mend"):
        table.add_column(heading, overflow="fold")
    for check in checks:
        table.add_row(check.name, f"[{colour[check.status]}]{check.status}[/]", check.found, check.mend)
    Console().print(table)


def main(arguments: list[str] | None = None) -> int:
    """``python -m genmf_mi.cli.doctor [--json] [--fix]``"""
    parser = argparse.ArgumentParser(prog="genmf-mi doctor", description="What is there and what is missing.")
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--fix", action="store_true", help="install the LPIPS weights and LLVM if missing")
    options = parser.parse_args(arguments)
    try:
        return doctor(json=options.json, fix=options.fix)
    except GenmfError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code


if __name__ == "__main__":
    sys.exit(main())

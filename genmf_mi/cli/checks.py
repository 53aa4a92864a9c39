"""The checks of ``genmf-mi doctor``.

They must run where everything else is missing, so nothing outside the standard library is imported at the top, and what
is examined only inside its check.
"""

from __future__ import annotations

import importlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Literal

from genmf_mi.core import llvm
from genmf_mi.render import variant

FREE_BYTES, CACHE_BYTES = 500e6, 50e6
"""Least free space for the files of a run, and for the kernels of one."""
PROBE_SECONDS = 120


@dataclass(frozen=True)
class Check:
    """One line of the report. ``missing`` makes a refinement impossible, ``optional`` does not; ``fix`` says what to
    do."""

    name: str
    status: Literal["ok", "missing", "optional"]
    detail: str
    fix: str = ""


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
        check_kernel_cache(),
        check_slicer(),
    ]


def check_python() -> Check:
    """Which interpreter runs; pip does not install the package into one that is too old."""
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
    if version is None or version[0] < 0:  # Dr.Jit reports -1 for none, and for LLVM 14 and older
        return Check("LLVM", "missing", "none that Dr.Jit can load", llvm.advice())
    detail = ".".join(map(str, version)) + (f" ({path})" if path else "")
    if version < llvm.OLDEST:
        return Check("LLVM", "missing", f"{detail}, too old for Dr.Jit", llvm.advice())
    return Check("LLVM", "ok", detail)


def check_rendering() -> list[Check]:
    """LLVM, an image rendered with it, and the GPU, in a process of its own, because Dr.Jit may abort it."""
    command = [sys.executable, "-c", "from genmf_mi.cli.checks import probe; probe()"]
    try:
        process = subprocess.run(command, capture_output=True, text=True, timeout=PROBE_SECONDS, check=False)
    except subprocess.TimeoutExpired:
        return [Check("Rendering", "missing", f"no image after {PROBE_SECONDS} s", "Look for a stuck process.")]
    lines = process.stdout.splitlines()
    if not lines:
        return [Check("Rendering", "missing", last_line(process.stderr), "Fix what is listed above first.")]
    report = json.loads(lines[0])
    library = check_llvm(tuple(report["llvm"]) if report["llvm"] else None, report["llvm_path"])
    if process.returncode == 0:
        rendering = Check("Rendering", "ok", variant.CPU)
    elif library.status == "missing":
        rendering = Check("Rendering", "missing", f"{variant.CPU} needs LLVM", "Fix LLVM first.")
    else:
        detail = f"{variant.CPU} failed: {last_line(process.stderr)}"
        rendering = Check("Rendering", "missing", detail, "Run `make setup`: it installs the tested versions.")
    if report["gpu"]:
        return [library, rendering, Check("GPU", "ok", f"{report['gpu']} ({variant.CUDA})")]
    absent = "none that both PyTorch and Dr.Jit see"
    return [library, rendering, Check("GPU", "optional", absent, "The CPU works, more slowly.")]


def check_weights() -> Check:
    """Whether the LPIPS weights are installed."""
    try:
        from genmf_mi.losses import lpips_weights as weights
    except ImportError as error:  # a package that it needs, with a line of its own in the report
        return Check("LPIPS weights", "missing", f"not examined: {error}", "Fix what is listed above first.")
    if missing := weights.missing():
        detail = f"no {' and '.join(missing)} in {weights.folder()}"
        return Check("LPIPS weights", "missing", detail, weights.HOW_TO_INSTALL)
    return Check("LPIPS weights", "ok", str(weights.folder()))


def check_disk(folder: Path, name: str) -> Check:
    """Whether a run can write its files to ``folder``."""
    if not os.access(folder, os.W_OK):
        return Check(name, "missing", f"{folder} is not writable", "Go to a folder of yours, or choose another --out.")
    free = shutil.disk_usage(folder).free
    detail = f"{folder}, {free / 1e9:.1f} GB free"
    if free < FREE_BYTES:
        return Check(name, "missing", detail, "Free some space: a run writes up to 500 MB.")
    return Check(name, "ok", detail)


def check_kernel_cache() -> Check:
    """Whether Dr.Jit can keep the kernels that it compiles. It works without, so a refinement does not mention it."""
    folder = Path(os.environ.get("DRJIT_CACHE_DIR") or os.path.expanduser("~/.drjit"))
    existing = next((place for place in (folder, *folder.parents) if os.path.exists(place)), Path("/"))
    detail = f"{folder}, {shutil.disk_usage(existing).free / 1e9:.1f} GB free"
    if os.access(existing, os.W_OK) and shutil.disk_usage(existing).free >= CACHE_BYTES:
        return Check("Kernel cache", "ok", detail)
    advice = "Free some space, or point DRJIT_CACHE_DIR to another folder, or every run compiles its kernels anew."
    return Check("Kernel cache", "optional", f"cannot be written: {detail}", advice)


def check_slicer() -> Check:
    """Whether parts can be sliced as a print shop would. `genmf-mi print-check` has a simpler slicer of its own."""
    try:
        from genmf_mi.printing import slicer
    except ImportError as error:
        return Check("Slicer", "optional", f"not examined: {error}", "Fix what is listed above first.")
    program = slicer.find()
    if program is None:
        return Check("Slicer", "optional", "none, so print-check uses its own", slicer.INSTALL)
    return Check("Slicer", "ok", str(program))


def probe() -> None:
    """Print what Dr.Jit sees as JSON, then render an image of 8 × 8 pixels; exit code 0 says that it worked."""
    import mitsuba as mi
    import torch

    gpu = torch.cuda.get_device_name() if variant.cuda_available() else ""
    report = {"llvm": variant.llvm_version(), "llvm_path": _llvm_path(), "gpu": gpu}
    print(json.dumps(report), flush=True)
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


def last_line(text: str) -> str:
    """The last line of what a process printed, which says why it failed."""
    return text.strip().splitlines()[-1] if text.strip() else "no message"

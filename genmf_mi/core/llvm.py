"""Where LLVM lies on this machine, and how it and the other libraries outside Python are installed.

Dr.Jit compiles for the CPU with LLVM's shared library, which it looks for when it is imported: in
``DRJIT_LIBLLVM_PATH``, else in the folders of Debian and of Homebrew on Apple Silicon, else by the loader. What lies
elsewhere, such as on Fedora, in a conda environment, in a Python package or where LLVM's installer for Windows puts it,
is found here. Only the standard library is needed.
"""

from __future__ import annotations

import os
import platform
import re
import shutil
import sys
from collections.abc import Iterable
from importlib import metadata
from pathlib import Path

OLDEST = (17, 0, 0)
"""With LLVM 14 to 16 Dr.Jit aborts the process at the first real kernel and raises nothing."""
VARIABLE = "DRJIT_LIBLLVM_PATH"
DEBIAN_PACKAGES = ("libllvm19", "libatomic1", "libgl1", "libopengl0", "libcom-err2")
"""LLVM, and what a Debian without a desktop lacks of what the wheels of Dr.Jit and PyMeshLab are linked with."""
WHEEL = "karellen-llvm-core"
"""The package behind the extra ``llvm``, for Linux on x86-64: docs/install.md says what is known of it."""
COMMANDS = {
    "Debian and Ubuntu": f"sudo apt-get install {' '.join(DEBIAN_PACKAGES)}",
    "Fedora": "sudo dnf install llvm-libs libatomic libglvnd-glx libglvnd-opengl libcom_err",
    "macOS": "brew install llvm",
    "Windows": "winget install LLVM.LLVM",
}
"""What installs LLVM 17 or newer and the other libraries, per system."""
DRJIT_LOOKS_IN = (
    *(f"/usr/lib/{name}" for name in ("x86_64-linux-gnu", "aarch64-linux-gnu", "wsl/lib")),
    "/opt/homebrew/Cellar/llvm/*/lib",
)
_ELSEWHERE = {
    "linux": ("/usr/lib64", "/usr/lib", "/usr/lib/llvm-*/lib", "/usr/lib/llvm*/lib64"),
    "darwin": ("/opt/homebrew/opt/llvm*/lib", "/usr/local/opt/llvm*/lib"),
    "win32": ("C:/Program Files/LLVM/bin",),
}
_LIBRARY = re.compile(r"libLLVM(-\d+)?\.(so[.\d]*|dylib)|LLVM-C\.dll")


def announce() -> None:
    """Tell Dr.Jit of the newest LLVM that it would not find by itself, unless it finds one that it can use or was told
    of one. Must be called before Dr.Jit is imported for the first time."""
    if VARIABLE in os.environ or "drjit" in sys.modules:
        return
    if any(version(library) >= OLDEST[0] for library in libraries(DRJIT_LOOKS_IN)):
        return
    places = (f"{sys.prefix}/lib", f"{sys.prefix}/Library/bin", *_ELSEWHERE.get(sys.platform, ()))
    found = [*libraries(places), *from_wheel()]
    if found:
        os.environ[VARIABLE] = str(max(found, key=version))


def libraries(folders: Iterable[str]) -> list[Path]:
    """The shared libraries of LLVM that Dr.Jit may be able to use, in absolute folders that may hold wildcards."""
    found: list[Path] = []
    for folder in map(Path, folders):
        anchor = Path(folder.anchor)
        found += anchor.glob(f"{folder.relative_to(anchor).as_posix()}/*LLVM*")
    named = [path for path in found if _LIBRARY.fullmatch(path.name) and path.is_file()]
    return sorted(path for path in named if version(path) >= OLDEST[0])


def version(library: Path) -> int:
    """The major version that the name of a library or of its folder tells, 10⁶ if none does: that is the newest where
    packages name it so."""
    numbers = re.findall(r"(?<=LLVM-)\d+|(?<=LLVM\.so\.)\d+|(?<=llvm[-@])\d+", f"{library.parent} {library.name}")
    return int(numbers[-1]) if numbers else 10**6


def from_wheel() -> list[Path]:
    """The library of the installed package :data:`WHEEL`, if there is one."""
    try:
        files = metadata.files(WHEEL) or []
    except metadata.PackageNotFoundError:
        return []
    named = (file for file in files if re.fullmatch(r"libLLVM\.so\.\d.*", file.name))
    return [path for file in named if (path := Path(str(file.locate())).resolve()).is_file()]


def advice() -> str:
    """How to install LLVM on this machine, as a sentence; all ways if the machine is not known."""
    system = next((name for name, here in _systems().items() if here), None)
    if system is None:
        ways = ", ".join(f"on {name} `{command}`" for name, command in COMMANDS.items())
        return f"Install LLVM 17 or newer: {ways}; or point {VARIABLE} to its shared library."
    return f"Run `{COMMANDS[system]}`{_or_the_wheel()}."


def _or_the_wheel() -> str:
    on_linux = sys.platform == "linux" and platform.machine() == "x86_64"
    return " or, without rights, `pip install 'genmf-mi[llvm]'`" if on_linux else ""


def _systems() -> dict[str, bool]:
    return {
        "Debian and Ubuntu": shutil.which("apt-get") is not None,
        "Fedora": shutil.which("dnf") is not None,
        "macOS": sys.platform == "darwin",
        "Windows": sys.platform == "win32",
    }

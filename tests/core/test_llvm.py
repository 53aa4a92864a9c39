"""Where LLVM is looked for, and what is said where it is missing."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from genmf_mi.core import llvm
from genmf_mi.core.errors import SetupError
from genmf_mi.render import variant


@pytest.mark.parametrize(
    ("path", "version"),
    [
        ("/usr/lib/x86_64-linux-gnu/libLLVM.so.19.1", 19),
        ("/usr/lib/x86_64-linux-gnu/libLLVM-15.so.1", 15),
        ("/usr/lib64/libLLVM-20.so", 20),
        ("/opt/homebrew/opt/llvm@18/lib/libLLVM.dylib", 18),
        ("/usr/lib/llvm-16/lib/libLLVM.so", 16),
        ("/opt/homebrew/opt/llvm/lib/libLLVM.dylib", 10**6),
    ],
)
def test_version_in_a_name(path, version):
    assert llvm.version(Path(path)) == version


@pytest.fixture
def machine(tmp_path, monkeypatch):
    """A machine whose folders are below a temporary one; Dr.Jit is as good as not imported."""
    monkeypatch.delenv(llvm.VARIABLE, raising=False)
    monkeypatch.delitem(sys.modules, "drjit", raising=False)
    monkeypatch.setattr(llvm, "DRJIT_LOOKS_IN", (str(tmp_path / "debian"),))
    monkeypatch.setattr(llvm, "_ELSEWHERE", {sys.platform: (str(tmp_path / "llvm-*/lib"), str(tmp_path / "fedora"))})
    monkeypatch.setattr(llvm, "from_wheel", list)
    monkeypatch.setattr(sys, "prefix", str(tmp_path / "prefix"))

    def add(*names: str) -> None:
        for name in names:
            (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / name).touch()

    return add


def announced(tmp_path: Path) -> str | None:
    llvm.announce()
    told = os.environ.pop(llvm.VARIABLE, None)
    return told and Path(told).relative_to(tmp_path).as_posix()


def test_what_drjit_finds_itself_is_left_to_it(machine, tmp_path):
    machine("debian/libLLVM.so.19.1", "fedora/libLLVM.so.21.1")
    assert announced(tmp_path) is None


def test_the_newest_elsewhere_is_named(machine, tmp_path):
    machine("debian/libLLVM-15.so.1", "llvm-18/lib/libLLVM.so", "fedora/libLLVM.so.20.1", "fedora/libLLVMSupport.so")
    assert announced(tmp_path) == "fedora/libLLVM.so.20.1"


def test_old_ones_are_not_named(machine, tmp_path):
    machine("debian/libLLVM-14.so.1", "llvm-16/lib/libLLVM.so")
    assert announced(tmp_path) is None


def test_a_choice_of_the_user_stands(machine, tmp_path, monkeypatch):
    machine("fedora/libLLVM.so.20.1")
    monkeypatch.setenv(llvm.VARIABLE, "mine")
    llvm.announce()
    assert os.environ[llvm.VARIABLE] == "mine"


def test_the_wheel(monkeypatch, tmp_path):
    """As its record lists it: the library, whose links are made at the first start of Python."""
    (tmp_path / "site/karellen_llvm_core-19.1.7.dist-info").mkdir(parents=True)
    (tmp_path / "libLLVM.so.19.1").touch()
    info = tmp_path / "site/karellen_llvm_core-19.1.7.dist-info"
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: karellen-llvm-core\nVersion: 19.1.7\n")
    (info / "RECORD").write_text("../libLLVM.so.19.1,,\n../libLTO.so.19.1,,\n")
    monkeypatch.syspath_prepend(tmp_path / "site")
    assert llvm.from_wheel() == [tmp_path / "libLLVM.so.19.1"]


@pytest.mark.parametrize(
    ("platform", "program", "line"),
    [
        ("linux", "apt-get", "sudo apt-get install libllvm19 libatomic1 libgl1 libopengl0 libcom-err2"),
        ("linux", "dnf", "sudo dnf install llvm-libs libatomic libglvnd-glx libglvnd-opengl libcom_err"),
        ("darwin", None, "brew install llvm"),
        ("win32", None, "winget install LLVM.LLVM"),
    ],
)
def test_advice(platform, program, line, monkeypatch):
    monkeypatch.setattr(sys, "platform", platform)
    monkeypatch.setattr(llvm.shutil, "which", lambda name: name if name == program else None)
    assert f"Run `{line}`" in llvm.advice()


def test_advice_for_an_unknown_system_names_them_all(monkeypatch):
    monkeypatch.setattr(llvm.sys, "platform", "linux")
    monkeypatch.setattr(llvm.shutil, "which", lambda name: None)
    for line in llvm.COMMANDS.values():
        assert line in llvm.advice()


@pytest.mark.parametrize(("version", "found"), [(None, "no LLVM"), ((15, 0, 6), "15.0.6, which is too old")])
def test_the_first_command_says_what_is_missing(version, found, monkeypatch):
    monkeypatch.setattr(variant, "llvm_version", lambda: version)
    with pytest.raises(SetupError, match=rf"there is .*{found}.*libllvm19|{found}.*dnf|{found}.*brew"):
        variant.use("cpu")


def test_it_comes_before_drjit():
    """The package that renders names the library, before one of its modules imports Dr.Jit."""
    code = "import sys, genmf_mi.render; print('drjit' in sys.modules, 'genmf_mi.core.llvm' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, encoding="utf-8", check=True)
    assert done.stdout.split() == ["False", "True"]


def test_a_library_that_the_wheels_need_is_named_with_the_way_to_install_it():
    """As on a Debian without a desktop, where Dr.Jit's own explanation fails."""
    code = """
import sys
class Missing:
    def find_spec(name, path=None, target=None):
        if name == "drjit":
            try:
                raise ImportError("libatomic.so.1: cannot open shared object file")
            except ImportError:
                raise NameError("name '_drjit_ext' is not defined")
sys.meta_path.insert(0, Missing)
from genmf_mi.cli import main
sys.exit(main.main(["refine", "ball"]))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, encoding="utf-8", check=False)
    assert done.returncode == 2 and len(done.stderr.splitlines()) == 1
    assert "libatomic.so.1" in done.stderr and any(way in done.stderr for way in llvm.COMMANDS.values())

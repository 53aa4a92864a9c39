"""The checks of the doctor and what it installs; nothing is installed here."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest

from genmf_mi.cli import checks, doctor
from genmf_mi.cli import main as cli
from genmf_mi.cli.checks import Check
from genmf_mi.core.errors import SetupError


@pytest.mark.parametrize(
    ("version", "status"),
    [
        (None, "missing"),
        ((-1, -1, -1), "missing"),
        ((15, 0, 6), "missing"),
        ((16, 0, 6), "missing"),
        ((17, 0, 0), "ok"),
        ((19, 1, 7), "ok"),
    ],
)
def test_llvm_versions(version, status):
    check = checks.check_llvm(version)
    assert check.status == status
    assert (check.fix != "") == (status == "missing")


def test_this_machine(capsys):
    status = doctor.doctor(json=True)
    report = json.loads(capsys.readouterr().out)
    found = {check["name"]: check for check in report["checks"]}
    assert {
        "Python",
        "Mitsuba",
        "Dr.Jit",
        "PyTorch",
        "PyMeshLab",
        "LLVM",
        "Rendering",
        "GPU",
        "LPIPS weights",
        "Kernel cache",
    } <= found.keys()
    assert status == (0 if report["ok"] else 1)
    assert report["ok"] == all(check["status"] != "missing" for check in report["checks"])
    assert all(check["fix"] for check in report["checks"] if check["status"] != "ok")


def test_an_abort_of_drjit_is_survived(monkeypatch):
    died = subprocess.CompletedProcess(
        [], -6, '{"llvm": [19, 1, 7], "llvm_path": "", "gpu": ""}\n', "LLVM ERROR: Cannot select"
    )
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: died)
    llvm, rendering, gpu = checks.check_rendering()
    assert (llvm.status, rendering.status, gpu.status) == ("ok", "missing", "optional")
    assert "Cannot select" in rendering.detail


def test_missing_weights_fail_the_examination(tmp_path, monkeypatch):
    monkeypatch.delenv("GENMF_LPIPS_WEIGHTS", raising=False)
    monkeypatch.setenv("GENMF_CACHE", str(tmp_path))
    check = checks.check_weights()
    assert check.status == "missing"
    assert "genmf-mi weights" in check.fix


def test_missing_package():
    assert checks.check_package("no_such_package", "Nothing").status == "missing"


def test_table_and_exit_status(monkeypatch, capsys):
    monkeypatch.setattr(
        doctor, "examine", lambda: [Check("LLVM", "missing", "none", "install it"), Check("GPU", "optional", "none")]
    )
    assert doctor.doctor() == 1
    assert "install it" in capsys.readouterr().out
    monkeypatch.setattr(doctor, "examine", lambda: [Check("LLVM", "ok", "19"), Check("GPU", "optional", "none")])
    assert doctor.doctor() == 0


def test_fix_installs_what_is_missing(monkeypatch, capsys):
    installed = []
    monkeypatch.setattr(
        doctor,
        "examine",
        lambda: [Check("LLVM", "ok" if installed else "missing", ""), Check("LPIPS weights", "ok", "")],
    )
    monkeypatch.setattr(doctor, "install_llvm", lambda: installed.append("llvm"))
    monkeypatch.setattr(doctor, "install_weights", lambda: installed.append("weights"))
    assert doctor.doctor(fix=True) == 0
    assert installed == ["llvm"]
    assert doctor.doctor(fix=True) == 0
    assert installed == ["llvm"]


def test_fix_that_fails_says_why(monkeypatch, capsys):
    """And installs the rest."""
    installed = []
    monkeypatch.setattr(
        doctor, "examine", lambda: [Check("LLVM", "missing", ""), Check("LPIPS weights", "missing", "")]
    )
    monkeypatch.setattr(doctor, "install_weights", lambda: installed.append("weights"))
    monkeypatch.setattr(doctor.shutil, "which", lambda name: None)
    assert cli.main(["doctor", "--fix"]) == 1
    assert "cannot be installed from here" in capsys.readouterr().err
    assert installed == ["weights"]


def test_llvm_without_rights_names_the_command(monkeypatch):
    monkeypatch.setattr(doctor.os, "geteuid", lambda: 1000)
    monkeypatch.setattr(doctor.shutil, "which", lambda name: f"/usr/bin/{name}")
    monkeypatch.setattr(
        subprocess, "run", lambda command, **_: subprocess.CompletedProcess(command, 1, "", "password needed")
    )
    with pytest.raises(SetupError, match="Run `sudo apt-get install libllvm19 "):
        doctor.install_llvm()


def test_llvm_as_user_goes_through_sudo(monkeypatch):
    commands = []
    monkeypatch.setattr(doctor.os, "geteuid", lambda: 1000)
    monkeypatch.setattr(doctor.shutil, "which", lambda name: f"/usr/bin/{name}")

    def run(command, **_):
        commands.append(command)
        return subprocess.CompletedProcess(command, 0, "", "")

    monkeypatch.setattr(subprocess, "run", run)
    doctor.install_llvm()
    assert all(command[:2] == ["sudo", "-n"] for command in commands)
    assert {"libllvm19", "libatomic1"} <= set(commands[-1])
    assert "install" in commands[-1]


def test_kernel_cache(tmp_path, monkeypatch):
    """Dr.Jit works without one, so that a refinement does not mention it."""
    monkeypatch.setenv("DRJIT_CACHE_DIR", str(tmp_path / "deep" / "kernels"))
    assert checks.check_kernel_cache().status == "ok"
    monkeypatch.setattr(checks, "CACHE_BYTES", 1e18)
    check = checks.check_kernel_cache()
    assert check.status == "optional" and "DRJIT_CACHE_DIR" in check.fix and "kernels" in check.detail


def test_it_runs_where_everything_is_missing(tmp_path):
    """As after a failed installation: each package that cannot be imported is a line of the report."""
    missing = ("mitsuba", "drjit", "torch", "pymeshlab", "numpy", "scipy", "skfem", "igl", "trimesh", "matplotlib")
    code = f"""
import sys
class Missing:
    def find_spec(name, path=None, target=None):
        if name.partition(".")[0] in {missing}:
            raise ModuleNotFoundError("No module named " + name)
sys.meta_path.insert(0, Missing)
from genmf_mi.cli import checks, main
checks.subprocess.run = lambda *_, **__: checks.subprocess.CompletedProcess([], 1, "", "ImportError: no mitsuba")
sys.exit(main.main(["doctor", "--json"]))
"""
    command = [sys.executable, "-c", code]
    environment = {**os.environ, "GENMF_CACHE": str(tmp_path)}
    process = subprocess.run(command, capture_output=True, encoding="utf-8", env=environment, check=False)
    assert process.returncode == 1 and process.stderr == ""
    report = {check["name"]: check["status"] for check in json.loads(process.stdout)["checks"]}
    assert [name for name, status in report.items() if status == "missing"] == [
        "Mitsuba", "Dr.Jit", "PyTorch", "PyMeshLab", "Rendering", "LPIPS weights"]  # fmt: skip
    assert "skfem" not in process.stdout.lower() and "scikit-fem" not in process.stdout.lower()


def test_slicer(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    assert checks.check_slicer().status == "optional" and "prusa-slicer" in checks.check_slicer().fix
    program = tmp_path / "prusa-slicer"
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    assert checks.check_slicer().status == "ok" and checks.check_slicer().detail == str(program)

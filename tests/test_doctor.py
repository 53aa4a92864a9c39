"""The doctor's verdicts and cures; the machine itself is only looked at."""

from __future__ import annotations

import json
import subprocess

import pytest

from genmf_mi.cli import doctor
from genmf_mi.cli.doctor import Check
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
    check = doctor.check_llvm(version)
    assert check.status == status
    assert (check.mend != "") == (status == "missing")


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
    } <= found.keys()
    assert status == (0 if report["ok"] else 1)
    assert report["ok"] == all(check["status"] != "missing" for check in report["checks"])
    assert all(check["mend"] for check in report["checks"] if check["status"] != "ok")


def test_an_abort_of_drjit_is_survived(monkeypatch):
    died = subprocess.CompletedProcess(
        [], -6, '{"llvm": [19, 1, 7], "llvm_path": "", "gpu": ""}\n', "LLVM ERROR: Cannot select"
    )
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: died)
    llvm, rendering, gpu = doctor.check_rendering()
    assert (llvm.status, rendering.status, gpu.status) == ("ok", "missing", "optional")
    assert "Cannot select" in rendering.found


def test_missing_weights_fail_the_examination(tmp_path, monkeypatch):
    monkeypatch.delenv("GENMF_LPIPS_WEIGHTS", raising=False)
    monkeypatch.setenv("GENMF_CACHE", str(tmp_path))
    check = doctor.check_weights()
    assert check.status == "missing"
    assert "genmf-mi weights" in check.mend


def test_missing_package():
    assert doctor.check_package("no_such_package", "Nothing").status == "missing"


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
    monkeypatch.setattr(doctor, "install", lambda: installed.append("weights"))
    assert doctor.doctor(fix=True) == 0
    assert installed == ["llvm"]
    assert doctor.doctor(fix=True) == 0
    assert installed == ["llvm"]


def test_fix_that_fails_says_why(monkeypatch, capsys):
    monkeypatch.setattr(doctor, "examine", lambda: [Check("LLVM", "missing", "")])
    monkeypatch.setattr(doctor.shutil, "which", lambda name: None)
    assert doctor.doctor(fix=True) == 1
    assert "cannot be installed from here" in capsys.readouterr().err


def test_llvm_without_rights_names_the_command(monkeypatch):
    monkeypatch.setattr(doctor.os, "geteuid", lambda: 1000)
    monkeypatch.setattr(doctor.shutil, "which", lambda name: f"/usr/bin/{name}")
    monkeypatch.setattr(
        subprocess, "run", lambda command, **_: subprocess.CompletedProcess(command, 1, "", "password needed")
    )
    with pytest.raises(SetupError, match="Run `sudo apt-get install libllvm19`"):
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
    assert commands[-1][-1] == "libllvm19"
    assert "install" in commands[-1]

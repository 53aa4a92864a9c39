"""The package as it is installed: what importing it costs, what it offers, what it ships."""

from __future__ import annotations

import configparser
import inspect
import re
import subprocess
import sys
from importlib import import_module, resources
from pathlib import Path

import pytest

import genmf_mi

ROOT = Path(__file__).parents[1]


def run(code: str) -> str:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, encoding="utf-8", check=True)
    return done.stdout.strip()


@pytest.mark.parametrize("module", ["genmf_mi", "genmf_mi.cli.main"])
def test_import_starts_neither_mitsuba_nor_torch(module):
    heavy = "{'mitsuba', 'drjit', 'torch', 'pymeshlab', 'matplotlib', 'igl'}"
    assert run(f"import sys, {module}; print(sorted({heavy} & set(sys.modules)))") == "[]"


def test_help_starts_nothing_heavy():
    code = "import sys; from genmf_mi.cli.main import main; main(['refine', '--help'])"
    code = f"try:\n    {code}\nfinally:\n    print({{'mitsuba', 'torch', 'trimesh'}} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, encoding="utf-8", check=False)
    assert "--max-relief-mm" in done.stdout
    assert done.stdout.rstrip().endswith("set()")


def test_everything_promised_is_there():
    for name in genmf_mi.__all__:
        assert callable(getattr(genmf_mi, name))
        assert name in dir(genmf_mi)
    assert next(iter(inspect.signature(genmf_mi.refine).parameters)) == "asset"
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = genmf_mi.nothing


def test_plugins_and_scenes_are_inside_the_package():
    assert resources.files("genmf_mi.scenes").joinpath("default.xml").is_file()
    assert resources.files("genmf_mi").joinpath("py.typed").is_file()
    # The name must not land in site-packages, where it could be anyone's.
    assert import_module("genmf_mi.scenes").__name__ == "genmf_mi.scenes"
    assert run("import importlib.util as u; print(u.find_spec('genmf_mi.plugins') is not None)") == "True"


def test_every_package_is_installed():
    settings = configparser.ConfigParser()
    settings.read(ROOT / "setup.cfg")
    listed = set(settings["options"]["packages"].split())
    inside = {".".join(path.parent.relative_to(ROOT).parts) for path in ROOT.glob("genmf_mi/**/__init__.py")}
    assert listed == inside | {"genmf_mi.plugins", "genmf_mi.scenes"}


def test_everything_required_is_pinned():
    settings = configparser.ConfigParser()
    settings.read(ROOT / "setup.cfg")
    extras = settings["options.extras_require"]
    required = [settings["options"]["install_requires"], extras["oracle"], extras["docs"], extras["dev"]]
    pinned = {normalised(line) for line in (ROOT / "constraints.txt").read_text().splitlines()}
    lines = (line for text in required for line in text.splitlines() if line.strip())
    assert {normalised(requirement) for requirement in lines} <= pinned


def normalised(requirement: str) -> str:
    """The name in a requirement, as package indexes compare names."""
    return re.split(r"[<>=\[;]", requirement.strip())[0].lower().replace("_", "-")


def test_one_version():
    assert f"version: {genmf_mi.__version__}\n" in (ROOT / "CITATION.cff").read_text()

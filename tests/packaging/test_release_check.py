"""What `make release-check` concludes from metadata; the whole of it is run by hand before a release."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest

from genmf_mi import __version__

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def release():
    spec = importlib.util.spec_from_file_location("release_check", ROOT / "packaging" / "release_check.py")
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def installed(site: Path, name: str, *lines: str) -> None:
    folder = site / f"{name}-1.0.dist-info"
    folder.mkdir(parents=True)
    (folder / "METADATA").write_text("\n".join(["Metadata-Version: 2.4", f"Name: {name}", "Version: 1.0", *lines, ""]))


def test_licences(release, tmp_path):
    installed(tmp_path, "expression", "License-Expression: MIT")
    installed(tmp_path, "classified", "License: see file", "Classifier: License :: OSI Approved :: BSD License")
    installed(tmp_path, "words", "License: Apache-2.0", " with more lines")
    installed(tmp_path, "secret", "License: Proprietary")
    installed(tmp_path, "silent")
    installed(tmp_path, "pymeshlab", "License: GPL3")
    rows = release.licences(tmp_path)
    assert [row[2] for row in rows] == ["BSD License", "MIT", "GPL3", "Proprietary", "", "Apache-2.0"]
    assert release.unclear(rows) == ["secret", "silent"]
    assert "| silent | 1.0 | not stated |" in release.table(rows)


def test_what_is_installed_here_has_free_licences(release):
    site = Path(next(path for path in sys.path if path.endswith("site-packages")))
    assert len(release.licences(site)) > 3


def test_version_needs_its_papers(release):
    release.check_version(__version__)
    with pytest.raises(SystemExit, match=r"CITATION\.cff"):
        release.check_version("99.0")

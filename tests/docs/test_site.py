"""The site of the documentation: it is built without a warning, and nothing on it reaches out."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("mkdocs")
pytest.importorskip("material")
ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    """All pages, built as `make docs` does."""
    out = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(out)]
    environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, encoding="utf-8", check=False)
    assert done.returncode == 0, done.stderr
    assert "WARNING" not in done.stderr
    return out


def test_every_page_is_in_the_navigation(site):
    start = (site / "index.html").read_text(encoding="utf-8")
    for page in (ROOT / "docs").glob("*.md"):
        assert (site / f"{page.stem}.html").is_file() and f'href="{page.stem}.html"' in start.replace("./", ""), page
    assert "benchmarks.html" in start


def test_equations_and_docstrings(site):
    source = (ROOT / "docs" / "method.md").read_text(encoding="utf-8")
    equations = len(re.findall(r"\$\$.+?\$\$|\$[^$\n]+\$", source, flags=re.S))
    assert (site / "method.html").read_text(encoding="utf-8").count("<math") == equations > 15
    reference = (site / "reference.html").read_text(encoding="utf-8")
    assert "one-colour part whose relief shows the texture" in reference and "max_relief_mm" in reference
    assert not re.search(r":(func|class|mod):<code>", reference)


def test_nothing_is_fetched_from_elsewhere(site):
    for page in site.glob("*.html"):
        for tag in re.findall(r"<(?:script|link|img)[^>]*>", page.read_text(encoding="utf-8")):
            for address in re.findall(r'(?:src|href)="(https?:[^"]+)"', tag):
                assert 'rel="canonical"' in tag, address

"""What must hold before a release: `make release-check`.

Builds wheel and source archive, installs the wheel into an empty environment elsewhere, refines a sample there,
executes every command of the documentation at small settings, builds the site, and writes beside the archives

    LICENCES.md   the licence of every package that the environment has, as its metadata states it
    sbom.json     the same as a software bill of materials, CycloneDX 1.6

A package without a stated licence, or under one that is not known here, stops it, and so does a version that the
changelog or CITATION.cff does not have. PIP_ARGS is passed on to pip. `--keep DIR` installs into DIR and keeps it.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shlex
import subprocess
import sys
import tempfile
from importlib import metadata
from pathlib import Path

ROOT = Path(__file__).parents[1]
DIST = ROOT / "dist"
KNOWN = {
    "pymeshlab": "GPL-3.0; README says so",
    "openexr": "BSD-3-Clause, in the licence file of the package",
    "cuda-toolkit": "proprietary, of NVIDIA; with PyTorch's builds for CUDA only",
    "nvidia-": "proprietary, of NVIDIA; with PyTorch's builds for CUDA only",
}
"""What the metadata does not say, or what is not free and known to be so; a name that ends in a dash is a beginning."""
FREE = re.compile(
    r"apache|mit\b|bsd|isc|mpl|mozilla|python|psf|hpnd|zlib|unlicense|lgpl|cc0|public domain|historical|boost|nvidia",
    re.I,
)


def step(name: str) -> None:
    """Say what comes next."""
    print(f"=> {name}", flush=True)


def run(*command: str | Path, **options) -> str:
    """Run a command that must succeed; its output."""
    done = subprocess.run(
        [str(word) for word in command], capture_output=True, encoding="utf-8", check=False, **options
    )
    if done.returncode:
        sys.exit(f"error: {shlex.join(map(str, command))}\n{done.stdout}{done.stderr}")
    return done.stdout


def check_version(version: str) -> None:
    """The changelog has notes for the version, or notes that wait for one; CITATION.cff has the version."""
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    if f"## {version}" not in changelog and "## Unreleased" not in changelog:
        sys.exit(f"error: CHANGELOG.md has no section {version}")
    if f"version: {version}\n" not in (ROOT / "CITATION.cff").read_text(encoding="utf-8"):
        sys.exit(f"error: CITATION.cff does not say version {version}")


def licence(package: metadata.PackageMetadata) -> str:
    """The licence as the metadata states it: expression, classifier, or the first line of the text; empty if none."""
    if expression := package.get("License-Expression"):
        return expression
    classifiers = [c.rpartition(" :: ")[2] for c in package.get_all("Classifier", []) if c.startswith("License ::")]
    if named := [name for name in classifiers if name != "OSI Approved"]:
        return "; ".join(named)
    text = (package.get("License") or "").strip()
    return text.splitlines()[0][:80] if text and text.upper() != "UNKNOWN" else ""


def licences(site: Path) -> list[tuple[str, str, str]]:
    """Name, version and licence of every distribution in a site-packages folder, sorted by name."""
    found = {}
    for distribution in metadata.distributions(path=[str(site)]):
        name = distribution.metadata["Name"]
        found[name.lower()] = (name, distribution.version, licence(distribution.metadata))
    return [found[name] for name in sorted(found)]


def known(name: str) -> str:
    """What :data:`KNOWN` says of a package; empty if nothing."""
    beginnings = (key for key in KNOWN if key.endswith("-") and name.lower().startswith(key))
    return KNOWN.get(name.lower()) or KNOWN.get(next(beginnings, ""), "")


def unclear(rows: list[tuple[str, str, str]]) -> list[str]:
    """The packages whose licence is neither stated and free nor known."""
    return [name for name, _, text in rows if not known(name) and not FREE.search(text)]


def table(rows: list[tuple[str, str, str]]) -> str:
    """As Markdown."""
    body = (f"| {name} | {version} | {known(name) or text or 'not stated'} |" for name, version, text in rows)
    head = [
        "# Licences of what is installed with genmf-mi",
        "",
        "| package | version | licence, as its metadata says |",
        "|---|---|---|",
    ]
    return "\n".join([*head, *body, ""])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--keep", type=Path, help="the environment to install into; it stays")
    parser.add_argument("--iterations", type=int, default=20, help="of the refinement")
    chosen = parser.parse_args()
    step("building wheel and source archive")
    for old in DIST.glob("*") if DIST.is_dir() else ():
        old.unlink()
    run(sys.executable, "-m", "build", "--no-isolation", "--outdir", DIST, ROOT)
    (wheel,) = DIST.glob("*.whl")
    version = wheel.name.split("-")[1]
    check_version(version)
    with tempfile.TemporaryDirectory(prefix="genmf-release-") as temporary:
        folder = (chosen.keep or Path(temporary) / "env").absolute()
        step(f"installing {wheel.name} into {folder}")
        run(sys.executable, "-m", "venv", folder)
        python = folder / "bin" / "python"
        more = shlex.split(os.environ.get("PIP_ARGS", ""))
        run(python, "-m", "pip", "install", "--quiet", "--constraint", ROOT / "constraints.txt", *more, wheel)
        step("refining a sample there")
        away = {"cwd": temporary, "env": {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}}
        if run(folder / "bin" / "genmf-mi", "--version", **away).strip() != version:
            sys.exit("error: genmf-mi --version differs from the wheel's")
        count = str(chosen.iterations)
        print(run(folder / "bin/genmf-mi", "refine", "ball", "--preset", "draft", "--iterations", count, **away))
        step("licences and bill of materials")
        site = Path(run(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))").strip())
        rows = licences(site)
        (DIST / "LICENCES.md").write_text(table(rows), encoding="utf-8")
        if missing := unclear(rows):
            sys.exit(f"error: no free licence is stated for {', '.join(missing)}: see dist/LICENCES.md")
        bom = DIST / "sbom.json"
        run(sys.executable, "-m", "cyclonedx_py", "environment", "--spec-version", "1.6", "--output-file", bom, python)
        print(f"{len(rows)} packages, {len(json.loads(bom.read_text())['components'])} components in the SBOM")
    step("commands of the documentation")
    every = {**os.environ, "GENMF_TEST_COMMANDS": "1"}
    run(sys.executable, "-m", "pytest", "-q", ROOT / "tests" / "docs" / "test_commands_run.py", cwd=ROOT, env=every)
    step("documentation")
    run(sys.executable, "-m", "mkdocs", "build", "--quiet", "--strict", "--config-file", ROOT / "mkdocs.yml")
    print(f"ready: {', '.join(sorted(path.name for path in DIST.iterdir()))}, site/")


if __name__ == "__main__":
    main()

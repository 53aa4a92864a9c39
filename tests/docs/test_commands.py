"""Every command on the pages: blocks of `sh` are taken apart, and each `genmf-mi` is given its own arguments."""

from __future__ import annotations

import functools
import re
import shlex
from pathlib import Path

import pytest
import tyro

from genmf_mi.cli import main as cli

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")), ROOT / "integrations" / "comfyui" / "README.md"]
OURS = {"genmf-mi", "env/bin/genmf-mi"}
OTHERS = {
    "make", "python", "pip", "sudo", "docker", "uv", "uvx", "git", "curl", "ls", "cd", "export", "source", "for",
    "done", "ray", "sbatch", "kubectl", "case",
}  # fmt: skip
"""What else may stand at the beginning of a line."""


def commands(page: Path) -> list[list[str]]:
    """The words of every line of every block of shell, continued lines joined, comments left out."""
    blocks = re.findall(r"^```(?:sh|bash|console)\n(.*?)^```", page.read_text(encoding="utf-8"), flags=re.M | re.S)
    lines = [line for block in blocks for line in block.replace("\\\n", " ").splitlines()]
    return [words for line in lines if (words := shlex.split(line, comments=True))]


def ours(page: Path) -> list[list[str]]:
    """The arguments of each `genmf-mi`, up to a redirection, a pipe or a second command; also those in a container."""
    found = []
    for words in commands(page):
        while words and re.fullmatch(r"\w+=.*", words[0]):
            words = words[1:]
        start = 1 if words and words[0] in OURS else 0
        if words[:2] == ["docker", "run"]:
            start = next(i for i, word in enumerate(words) if word.startswith("genmf-mi")) + 1
        if start:
            end = next((i for i, word in enumerate(words) if word in (">", "|", "&&", "2>", "&")), len(words))
            found.append([word.rstrip(";") for word in words[start:end]])
    return found


class Parsed(Exception):
    """The arguments fit."""


@pytest.fixture
def only_parse(monkeypatch):
    """Commands end where their work would begin: each parses its arguments as always, files need not exist."""
    real = tyro.cli

    def parse(function, **options):
        if isinstance(function, type):
            real(function, **options)
            raise Parsed

        @functools.wraps(function)
        def instead(*_, **__):
            raise Parsed

        return real(instead, **options)

    monkeypatch.setattr(tyro, "cli", parse)


@pytest.mark.usefixtures("only_parse")
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.parent.name + "/" + page.name)
def test_arguments_fit(page, capsys):
    """Some commands look for their files before anything else; they have parsed their arguments then."""
    for arguments in ours(page):
        if arguments[0] in ("--help", "--version"):
            continue
        try:
            cli.main(arguments)
        except Parsed:
            continue
        except SystemExit as ended:
            pytest.fail(f"{page.name}: genmf-mi {shlex.join(arguments)} ended with {ended.code}")
        assert "does not exist" in capsys.readouterr().err, (
            f"{page.name}: {shlex.join(arguments)} does not reach its work"
        )


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.parent.name + "/" + page.name)
def test_other_commands_are_known(page):
    """A line begins with a program that the test knows, or one that the project brings."""
    for words in commands(page):
        while words and re.fullmatch(r"\w+=.*", words[0]):
            words = [words[0].partition("=$(")[2], *words[1:]] if "=$(" in words[0] else words[1:]
        program = words[0] if words else "true"
        assert program in OURS | OTHERS or (ROOT / program).is_file() or program == "true", shlex.join(words)
        for target in words[1:] if program == "make" else ():
            if re.fullmatch(r"[a-z-]+", target):
                assert re.search(rf"^{target}:", (ROOT / "Makefile").read_text(), flags=re.M), target


def test_there_are_commands():
    """The pages are read as they should be."""
    assert sum(len(ours(page)) for page in PAGES) > 40

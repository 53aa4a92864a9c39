"""What the site of MkDocs needs beyond its settings: which pages there are, links out of docs/, equations.

The pages are read on their own too, beside the code, so links like ``../examples/refine_mesh.py`` stay in them. On the
site, where there is no such file, the name alone is shown. Equations become MathML, which needs no scripts.
"""

from __future__ import annotations

import re
from pathlib import Path

from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[1]
GENERATED = {"benchmarks.md": ROOT / "benchmarks" / "results" / "README.md"}
"""Pages that lie elsewhere in the project."""


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Drop pages from the navigation that are not there, and add those that it does not name."""
    there = {path.name for path in Path(config.docs_dir).glob("*.md")} | set(GENERATED)
    named: set[str] = set()

    def kept(entries: list) -> list:
        result = []
        for entry in entries:
            ((title, target),) = entry.items()
            if isinstance(target, list):
                result += [{title: inner}] if (inner := kept(target)) else []
            elif target in there:
                named.add(target)
                result.append(entry)
        return result

    config.nav = kept(config.nav or [])
    if more := sorted(there - named):
        config.nav.append({"More": more})
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that lie elsewhere, with their links as seen from docs/."""
    for name, path in GENERATED.items():
        text = path.read_text(encoding="utf-8")
        for target in set(re.findall(r"\]\((?!http|#)([^)]+)\)", text)):
            text = text.replace(f"]({target})", f"]({_from_docs(path, target)})")
        files.append(File.generated(config, name, content=text))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Replace links to files that are not on the site by their names, and ``$$...$$`` and ``$...$`` by MathML."""
    known = {file.src_uri for file in files}
    elsewhere = {f"../{path.relative_to(ROOT).as_posix()}": name for name, path in GENERATED.items()}

    def link(match: re.Match[str]) -> str:
        target = match[2].partition("#")[0]
        if target in elsewhere:
            return f"[{match[1]}]({elsewhere[target]})"
        return match[0] if not target or target.startswith("http") or target in known else match[1]

    markdown = re.sub(r"(?<!!)\[([^\]]*)\]\(([^)\s]+)\)", link, markdown)
    if page.file.src_uri != "method.md":
        return markdown  # a dollar sign elsewhere is a dollar sign
    block = re.compile(r"\$\$(.+?)\$\$", re.S)
    markdown = block.sub(lambda match: f"\n{convert(match[1].strip(), display='block')}\n", markdown)
    return re.sub(r"\$([^$\n]+)\$", lambda match: convert(match[1]), markdown)


def on_page_content(html: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Take the roles out of the docstrings, such as ``:func:`` before a name: mkdocstrings would show them."""
    return re.sub(r":(?:class|func|mod|data|meth|attr|exc):(?=<code>)", "", html)


def _from_docs(page: Path, target: str) -> str:
    """A link of a page elsewhere, as it is written in docs/."""
    path = (page.parent / target.partition("#")[0]).resolve()
    docs = ROOT / "docs"
    return path.relative_to(docs).as_posix() if path.is_relative_to(docs) else f"../{path.relative_to(ROOT).as_posix()}"

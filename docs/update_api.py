"""Writes the tables of settings into docs/api.md, from the docstrings in genmf_mi/core/config.py.

    python docs/update_api.py

The tests fail while the page is out of date.
"""

from __future__ import annotations

import ast
import re
from pathlib import Path

PAGE = Path(__file__).with_name("api.md")
CONFIG = Path(__file__).parents[1] / "genmf_mi" / "core" / "config.py"


def fields(source: str, name: str) -> list[tuple[str, str, str, str]]:
    """Name, type, default and docstring of every field of the dataclass ``name``."""
    (block,) = (node for node in ast.parse(source).body if isinstance(node, ast.ClassDef) and node.name == name)
    found = []
    for node, after in zip(block.body, block.body[1:]):
        if not isinstance(node, ast.AnnAssign) or node.value is None:
            continue
        assert isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant), f"{node.target} has no docstring"
        text = " ".join(str(after.value.value).split())
        factory = re.search(r"default_factory=(\w+)", ast.unparse(node.value))
        default = f"{factory[1]}()" if factory else str(ast.get_source_segment(source, node.value))
        found.append((ast.unparse(node.target), ast.unparse(node.annotation), default, text))
    return found


def table(source: str, name: str) -> str:
    """The fields of a dataclass as Markdown."""
    rows = ["| name | type | default | meaning |", "|---|---|---|---|"]
    for field, kind, default, text in fields(source, name):
        kind = re.sub(r"Literal\[(.*)\]", lambda match: match[1].replace("'", '"'), kind)
        rows.append(f"| `{field}` | {kind} | `{default}` | {text} |")
    return "\n".join(rows)


def updated(page: str, source: str) -> str:
    """The page with its tables made anew; each lies between a comment with the name of the class and an end mark."""

    def replace(match: re.Match) -> str:
        return f"<!-- {match[1]} -->\n{table(source, match[1])}\n<!-- end -->"

    return re.sub(r"<!-- (\w+) -->\n.*?<!-- end -->", replace, page, flags=re.S)


if __name__ == "__main__":
    PAGE.write_text(updated(PAGE.read_text(encoding="utf-8"), CONFIG.read_text(encoding="utf-8")), encoding="utf-8")

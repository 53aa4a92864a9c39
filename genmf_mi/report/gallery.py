"""``gallery.html``: all parts of a batch on one page that works offline, with thousands of them too.

The page holds the figures; pictures lie in the run folders and are loaded as they come into view.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from importlib import resources

from jinja2 import Environment, StrictUndefined
from markupsafe import Markup


@dataclass(frozen=True)
class Part:
    """One item. picture, report: where its thumbnail and its report are, relative to the page; empty if there is none.

    text: what is wrong with it, or that it repeats another. scores: figures by name, as far as there are any.
    """

    name: str
    state: str
    picture: str = ""
    report: str = ""
    text: str = ""
    scores: dict[str, float] = field(default_factory=dict[str, float])


def gallery(title: str, parts: Sequence[Part], columns: dict[str, str], totals: Sequence[tuple[str, str]]) -> str:
    """The page as HTML text.

    Args:
        columns: the scores to show and to sort by, and what to call them. totals: names and values, for the head.
    """
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    rows = [{name: value for name, value in asdict(part).items() if value} for part in parts]
    # "<" would end the script element or begin a comment in it
    data = json.dumps({"parts": rows, "columns": columns}, separators=(",", ":")).replace("<", "\\u003c")
    states = sorted({part.state for part in parts})
    return environment.from_string(_file("gallery.html")).render(
        title=title,
        style=Markup(_file("gallery.css")),
        script=Markup(_file("gallery.js")),
        data=Markup(data),
        totals=totals,
        columns=columns,
        states=states,
    )


def _file(name: str) -> str:
    return resources.files("genmf_mi.report").joinpath(name).read_text(encoding="utf-8")

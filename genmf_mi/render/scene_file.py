"""Scene files: which one belongs to an object, what it includes, and which parameters it declares.

The bundled files hold an object's views and lights and include the rest (``_mesh.xml`` or ``_grid.xml``). An included
file is searched as Mitsuba does it: beside the file that includes it, then beside the scene file, then in the current
folder; at last among the bundled files, so that a copy of one of them works anywhere. As in Mitsuba, the first
``<default>`` of a name holds.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from importlib import resources
from pathlib import Path
from string import Template
from textwrap import dedent, indent
from xml.sax.saxutils import quoteattr

from genmf_mi.core.errors import SceneError

MESH, GRID = "mesh", "grid"
"""What a scene file shows; also the name of the parameter that takes its file."""
START = "start from the output of `genmf-mi scene`."
_PARAMETERS = {MESH: (MESH,), GRID: (GRID, "half", "x", "y", "z")}


def bundled_folder() -> Path:
    """Where the bundled scene files are."""
    return Path(str(resources.files("genmf_mi.scenes")))


def find(name: str, holds: str = MESH) -> Path:
    """The scene file of a bundled sample, or the default one; ``NAME_sdf`` is NAME stored as Φ and gets its views."""
    ending = ".xml" if holds == MESH else "_sdf.xml"
    path = bundled_folder() / f"{name.removesuffix('_sdf')}{ending}"
    included_only = path.name.startswith("_")
    return path if path.exists() and not included_only else path.with_name(f"default{ending}")


def read_defaults(xml: Path, holds: str = MESH) -> dict[str, str]:
    """The ``<default>`` parameters of a scene file and of all that it includes.

    Raises:
        SceneError: a file cannot be read, or there is no parameter for the ``mesh`` or ``grid`` that it should show.
    """
    defaults: dict[str, str] = {}
    _collect_defaults(Path(xml), Path(xml), (), defaults)
    if missing := [name for name in _PARAMETERS[holds] if name not in defaults]:
        raise SceneError(
            f'{xml} has no <default name="{missing[0]}" .../>, so no {holds} can be put in: see `genmf-mi scene`.'
        )
    return defaults


def standalone_xml(name: str, mesh: str | Path) -> str:
    """The scene file of a bundled sample (or the default one) without includes, as text to edit.

    name: of the sample. mesh: the default of the parameter ``mesh``; a refinement puts its own mesh there.
    """
    path = find(name)
    text = _with_includes(path.read_text(encoding="utf-8"), path.parent)
    value = quoteattr(str(mesh))
    return re.sub(r'(?<=<default name="mesh" value=)"[^"]*"', lambda _: value, text)


def one_line(error: Exception) -> str:
    """What the error says, as a sentence on one line."""
    return (" ".join(str(error).split()) or type(error).__name__).rstrip(".") + "."


def _collect_defaults(path: Path, xml: Path, parents: tuple[Path, ...], defaults: dict[str, str]) -> None:
    """Add the defaults of ``path``, which the ``parents`` include, to those of the scene file ``xml``."""
    if path.exists() and not path.is_file():  # a pipe or a device has no end
        raise SceneError(f"{path} is no file. Check the spelling, or {START}")
    try:
        root = ElementTree.parse(path).getroot()
    except FileNotFoundError as error:
        raise SceneError(f"there is no scene file {path}. Check the spelling, or {START}") from error
    except (ElementTree.ParseError, OSError, UnicodeDecodeError) as error:
        raise SceneError(f"{path} is not readable as XML: {one_line(error)} Fix it, or {START}") from error
    for element in root.iter():
        if element.tag == "default":
            defaults.setdefault(element.get("name", ""), element.get("value", ""))
        elif element.tag == "include":
            name = Template(element.get("filename", "")).safe_substitute(defaults)
            folders = (path.parent, xml.parent, Path.cwd(), bundled_folder())
            included = next((folder / name for folder in folders if name and (folder / name).is_file()), None)
            if included is None:
                raise SceneError(f'{path} includes a file "{name}", which does not exist. Fix it, or {START}')
            if included.resolve() in (*parents, path.resolve()):
                raise SceneError(f"{path} includes {included}, which includes it in turn. Fix it, or {START}")
            _collect_defaults(included, xml, (*parents, path.resolve()), defaults)


def _with_includes(text: str, folder: Path) -> str:
    """The text of a bundled file with the content of the files that it includes, indented to fit."""

    def content(match: re.Match[str]) -> str:
        included = (folder / match["name"]).read_text(encoding="utf-8")
        inner = re.sub(r".*<scene[^>]*>\n|</scene>\s*", "", included, flags=re.DOTALL)
        return indent(_with_includes(dedent(inner), folder), match["indent"])

    return re.sub(r'^(?P<indent> *)<include filename="(?P<name>[^"]*)"/>\n', content, text, flags=re.MULTILINE)

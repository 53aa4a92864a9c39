"""``genmf-mi scene``."""

from __future__ import annotations

from pathlib import Path

from genmf_mi.cli.arguments import call


def scene(asset: str, mesh: Path | None = None) -> int:
    """Print a scene file for an asset, to edit and use with --scene.

    Args:
        asset: A file or the name of a bundled sample.
        mesh: The mesh that the scene names; NAME.ply if not given. A refinement puts its own mesh in its place.
    """
    from genmf_mi.assets.samples import resolve
    from genmf_mi.render.scene import standalone_xml

    name = resolve(asset).stem
    print(standalone_xml(name, mesh or Path(f"{name}.ply")), end="")
    return 0


def main(arguments: list[str]) -> int:
    """Read the arguments and print the scene."""
    return call(scene, "scene", arguments)

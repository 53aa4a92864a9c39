"""What an uploaded model is, found out in a process of its own: its picture for the page, its size, its faults.

Reading is answered by one process that is kept warm, since somebody waits for it; making the model solid takes longer
and has a process for each model.
"""

from __future__ import annotations

import json
import os
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np

from genmf_mi.assets import asset as meshes
from genmf_mi.assets import samples
from genmf_mi.assets.asset import Asset
from genmf_mi.core.errors import GenmfError
from genmf_mi.core.files import write_text
from genmf_mi.mesh import solid
from genmf_mi.ui.preview_model import write_model

FEW_PIXELS = 256
"""Textures of fewer pixels a side show more of their pixels than of the object."""


def read(folder: Path, model: str, up: str) -> dict[str, Any]:
    """Read the model, write ``model.glb`` and ``analysis.json`` into ``folder``; returns the latter."""
    try:
        asset = meshes.load(model, None if up == "auto" else up)
        write_model(folder / "model.glb", asset)
        turn = meshes.turn_of(model, None if up == "auto" else up).ravel().tolist()
        result = {"state": "checking", "up": up, "turn": turn, "model": describe(asset)}
        result["findings"] = findings_of_colours(asset)
    except GenmfError as error:
        result = {"state": "failed", "up": up, "error": str(error)}
    except MemoryError:
        result = {"state": "failed", "up": up, "error": f"{model} is too large for the memory of this machine."}
    write_text(folder / "analysis.json", json.dumps(result))
    return result


def check(folder: Path, model: str, up: str) -> dict[str, Any]:
    """Make the model solid, and complete ``analysis.json`` with what was found on that."""
    result = json.loads((folder / "analysis.json").read_text(encoding="utf-8"))
    try:
        asset = meshes.load(model, None if up == "auto" else up)
        report = solid.solidify(asset.name, asset.vertices, asset.matter).report
        result |= {"state": "done", "findings": result.get("findings", []) + findings_of_solid(report)}
    except GenmfError as error:
        result |= {"state": "failed", "error": str(error)}
    if json.loads((folder / "analysis.json").read_text(encoding="utf-8"))["up"] != up:  # it was turned meanwhile
        return result
    write_text(folder / "analysis.json", json.dumps(result))
    return result


def sample(folder: Path, name: str, up: str) -> dict[str, Any]:
    """Write a bundled sample into ``folder/input``."""
    if name not in samples.NAMES:
        return {"state": "failed"}
    shutil.copyfile(samples.resolve(name), folder / "input" / f"{name}.glb")
    return {"state": "done"}


def describe(asset: Asset) -> dict[str, Any]:
    """Faces, extent in file units along x, y (up) and z, and whether there is a texture to show."""
    extent = np.ptp(asset.vertices[asset.faces].reshape(-1, 3), axis=0)
    return {
        "name": asset.name,
        "faces": len(asset.faces),
        "extent": [float(x) for x in extent],
        "textured": bool(asset.textured),
    }


def findings_of_colours(asset: Asset) -> list[dict[str, Any]]:
    """What there is to say about the colours, each a ``code`` that the page has words for."""
    if not asset.textured:
        return [{"code": "no-texture", "severity": "error"}]
    sides = [max(m.texture.pixels.shape[:2]) for m in asset.albedo.materials if m.texture is not None]
    if sides and max(sides) < FEW_PIXELS:
        return [{"code": "small-texture", "severity": "info", "count": max(sides)}]
    return []


def findings_of_solid(report: dict[str, Any]) -> list[dict[str, Any]]:
    """What was done to make the model solid, as far as it concerns who prints it: codes with a count."""
    found = [
        {"code": code, "severity": "info", "count": int(report.get(key, 0))}
        for code, key in (
            ("holes-closed", "holes_capped"),
            ("loose-parts-removed", "stray_bodies_dropped"),
            ("loose-faces-removed", "stray_faces_dropped"),
            ("cavities-filled", "cavities_filled"),
            ("voids-filled", "voids_filled"),
            ("faces-turned", "faces_turned"),
        )
        if report.get(key, 0)
    ]
    if report.get("rebuilt"):
        invented = round(100 * report.get("area_invented", 0.0))
        found.insert(0, {"code": "rebuilt", "severity": "warning", "count": invented})
    if report.get("bodies", 1) > 1:
        found.append({"code": "several-bodies", "severity": "warning", "count": int(report["bodies"])})
    return found or [{"code": "solid", "severity": "good"}]


def main() -> None:
    """Answer requests, one JSON object a line on standard input: ``task`` (``read``, ``check`` or ``sample``),
    ``folder``, ``model`` and ``up``. The answer is a line with ``state``."""
    for line in sys.stdin:
        request = json.loads(line)
        folder = Path(request["folder"])
        os.chdir(folder / "input")
        result = {"read": read, "check": check, "sample": sample}[request["task"]](
            folder, request["model"], request["up"]
        )
        print(json.dumps({"state": result["state"]}), flush=True)


if __name__ == "__main__":
    main()

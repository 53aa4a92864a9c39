"""The recipe of docs/blender.md, run in Blender without a window.

The module ``bpy`` is Blender itself, for one version of Python; ``GENMF_BLENDER_PYTHON`` names an interpreter that has
it (`pip install bpy`). Without one the test is skipped.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
import trimesh

import genmf_mi

PAGE = (Path(__file__).parents[2] / "docs" / "blender.md").read_text(encoding="utf-8")
OUT, IN = re.findall(r"```python\n(.*?)```", PAGE, flags=re.S)
SCENE = """
import bpy, math
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.mesh.primitive_cylinder_add(vertices=32, radius=0.5, depth=3)
body = bpy.context.object
image = bpy.data.images.new("paint", 64, 64)
image.pixels = [c for y in range(64) for x in range(64) for c in ((1, 1, 1, 1) if x // 8 % 2 else (0.1, 0.1, 0.1, 1))]
image.pack()
material = bpy.data.materials.new("paint")
material.use_nodes = True
texture = material.node_tree.nodes.new("ShaderNodeTexImage")
texture.image = image
shader = material.node_tree.nodes["Principled BSDF"]
material.node_tree.links.new(texture.outputs["Color"], shader.inputs["Base Color"])
body.data.materials.append(material)
"""
AFTER = """
for body in bpy.context.scene.objects:
    if body.type == "MESH":
        print("SIZE", body.name, *(round(side, 4) for side in body.dimensions))
"""


@pytest.fixture
def python() -> str:
    chosen = os.environ.get("GENMF_BLENDER_PYTHON") or (sys.executable if find_spec("bpy") else "")
    if not chosen:
        pytest.skip("no bpy: pip install bpy, or GENMF_BLENDER_PYTHON=/path/to/python")
    return chosen


def blender(python: str, code: str) -> str:
    """Run code in Blender; what it prints."""
    done = subprocess.run([python, "-c", code], capture_output=True, encoding="utf-8", check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_there_and_back(workplace, python):
    blender(python, SCENE + OUT)
    asset = genmf_mi.load("bust.glb")
    low, high = np.min(asset.vertices, axis=0), np.max(asset.vertices, axis=0)
    np.testing.assert_allclose(high - low, (1, 3, 1), atol=1e-4)  # z up in Blender is y up in the file
    assert asset.textured

    Path("runs/bust").mkdir(parents=True)
    trimesh.creation.box((1, 3, 1)).export("runs/bust/refined.glb")
    trimesh.creation.box((40, 40, 120)).export("runs/bust/refined.stl")
    told = blender(python, "import bpy\nbpy.ops.wm.read_factory_settings(use_empty=True)\n" + IN + AFTER)
    sizes = [tuple(map(float, line.split()[2:])) for line in told.splitlines() if line.startswith("SIZE")]
    assert (0.04, 0.04, 0.12) in sizes and (1.0, 1.0, 3.0) in sizes

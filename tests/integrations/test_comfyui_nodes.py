"""The nodes for ComfyUI, against stand-ins for its modules (comfy_stubs.py says why)."""

from __future__ import annotations

import asyncio
import importlib.util
import json
import sys
from dataclasses import fields
from pathlib import Path
from types import SimpleNamespace

import comfy_stubs
import pytest
import trimesh
from PIL import Image
from toys import painted

import genmf_mi
from genmf_mi.core.config import RefineConfig

FOLDER = Path(__file__).parents[2] / "integrations" / "comfyui"


@pytest.fixture
def comfy(tmp_path, monkeypatch):
    """The package of nodes, loaded as ComfyUI loads a folder of custom_nodes, and what ComfyUI is told."""
    told = comfy_stubs.install(monkeypatch, tmp_path)
    painted(tmp_path / "input" / "egg.ply")
    spec = importlib.util.spec_from_file_location("genmf_nodes", FOLDER / "__init__.py")
    assert spec and spec.loader
    package = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "genmf_nodes", package)
    spec.loader.exec_module(package)
    extension = asyncio.run(package.comfy_entrypoint())
    nodes = {node.define_schema().node_id: node for node in asyncio.run(extension.get_node_list())}
    yield SimpleNamespace(told=told, nodes=nodes, root=tmp_path)
    for name in [name for name in sys.modules if name.startswith("genmf_nodes.")]:
        del sys.modules[name]


def execute(node, **chosen):
    """As ComfyUI does: every input that is not given has its default."""
    schema = node.define_schema()
    values = {port.id: port.options["default"] for port in schema.inputs if "default" in port.options}
    output = node.execute(**values | chosen)
    assert len(output.args) == len(schema.outputs)
    return output


def test_schemas(comfy):
    assert len(comfy.nodes) == 5
    for node in comfy.nodes.values():
        schema = node.define_schema()
        assert len({port.id for port in schema.inputs}) == len(schema.inputs)
        for port in schema.inputs:
            if port.io_type == "COMBO" and "default" in port.options:
                assert port.options["default"] in port.options["options"]
    files = comfy.nodes["GenmfLoadTexturedMesh"].define_schema().inputs[0].options["options"]
    assert "egg.ply" in files and "sample: ball" in files
    settings = {port.id for port in comfy.nodes["GenmfRefineRelief"].define_schema().inputs} - {"asset", "preset"}
    assert settings <= {field.name for field in fields(RefineConfig)}


def test_load(comfy):
    node = comfy.nodes["GenmfLoadTexturedMesh"]
    assert execute(node, file="sample: ball").args == ({"file": "ball", "up": None},)
    assert execute(node, file="egg.ply", up="z").args[0] == {"file": str(comfy.root / "input/egg.ply"), "up": "z"}
    assert node.validate_inputs("egg.ply") is True and "no file" in node.validate_inputs("lost.glb")
    assert node.fingerprint_inputs("egg.ply") != node.fingerprint_inputs("sample: ball")

    def save_to(path: str) -> str:
        return trimesh.creation.box().export(path) and path

    made = execute(node, file="sample: ball", model=SimpleNamespace(format="glb", save_to=save_to))
    assert Path(made.args[0]["file"]).suffix == ".glb" and Path(made.args[0]["file"]).is_file()


@pytest.mark.usefixtures("small_refinements")
def test_the_workflow_from_file_to_part(comfy, two_views, monkeypatch):
    """A small refinement, through all nodes."""
    real = genmf_mi.refine

    def small(asset, config, **options):
        from dataclasses import replace

        assert config.size_mm == 60 and config.stress is False
        return real(asset, replace(config, resolution=96, edge_mm=6.0), scene=two_views, **options)

    monkeypatch.setattr(genmf_mi, "refine", small)
    (asset,) = execute(comfy.nodes["GenmfLoadTexturedMesh"], file="egg.ply").args
    run, image = execute(
        comfy.nodes["GenmfRefineRelief"], asset=asset, preset="draft", size_mm=60.0, iterations=2, device="cpu"
    ).args
    assert tuple(image.shape[::3]) == (1, 3) and 0 <= float(image.min()) < float(image.max()) <= 1
    assert max(value / total for value, total, _ in comfy.told.progress) == 1
    assert any(isinstance(picture, Image.Image) for *_, picture in comfy.told.progress)
    assert run["folder"] == str(comfy.root / "output/genmf/egg_00001")

    for suffix in ("3mf", "stl", "glb"):
        saved = execute(comfy.nodes["GenmfSavePart"], run=run, format=suffix)
        (file,) = saved.args
        assert trimesh.load_mesh(file).is_watertight
        assert saved.ui["3d"][0]["filename"] == Path(file).name
    preview = execute(comfy.nodes["GenmfPreviewBeforeAfter"], run=run)
    assert preview.ui["images"].shape == image.shape
    text, page, metrics = execute(comfy.nodes["GenmfReport"], run=run).args
    assert "LPIPS" in text and Path(page).is_file() and json.loads(metrics)["asset"] == "egg"


def test_cancel_stops_the_run(comfy, monkeypatch):
    comfy.told.cancelled = True

    def refine(asset, config, *, progress, **options):
        progress.stage("loading")

    monkeypatch.setattr(genmf_mi, "refine", refine)
    with pytest.raises(comfy_stubs.Interrupted):
        execute(comfy.nodes["GenmfRefineRelief"], asset={"file": "ball", "up": None}, preset="draft")


def test_workflow_file_fits_the_schemas(comfy):
    """Each node of workflow.json has the ports and as many values as its schema, and each link joins equal types."""
    workflow = json.loads((FOLDER / "workflow.json").read_text())
    found = {node["id"]: node for node in workflow["nodes"]}
    assert {node["type"] for node in found.values()} == set(comfy.nodes)
    for node in found.values():
        schema = comfy.nodes[node["type"]].define_schema()
        widgets = [port for port in schema.inputs if port.io_type in comfy_stubs.ACCEPTED]
        assert len(node["widgets_values"]) == len(widgets)
        for port, value in zip(widgets, node["widgets_values"], strict=True):
            assert port.io_type != "COMBO" or value in port.options["options"]
        assert [one["type"] for one in node["outputs"]] == [port.io_type for port in schema.outputs]
        assert [one["name"] for one in node["inputs"]] == [p.id for p in schema.inputs if p not in widgets]
    for number, start, out, end, into, kind in workflow["links"]:
        assert found[start]["outputs"][out]["type"] == found[end]["inputs"][into]["type"] == kind
        assert number in found[start]["outputs"][out]["links"] and found[end]["inputs"][into]["link"] == number

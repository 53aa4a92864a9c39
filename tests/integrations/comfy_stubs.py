"""Stand-ins for what the nodes use of ComfyUI, made from its documented V3 schema (docs.comfy.org, custom nodes, "V3
migration") and the signatures of ``comfy_api.latest``: unknown arguments are errors, as there."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

COMMON = {"display_name", "optional", "tooltip", "lazy", "extra_dict", "raw_link", "advanced"}
WIDGET = COMMON | {"default", "socketless", "force_input"}
ACCEPTED = {
    "COMBO": WIDGET | {"options", "control_after_generate", "upload", "image_folder", "remote"},
    "FLOAT": WIDGET | {"min", "max", "step", "round", "display_mode"},
    "INT": WIDGET | {"min", "max", "step", "control_after_generate", "display_mode"},
    "BOOLEAN": WIDGET | {"label_on", "label_off"},
    "STRING": WIDGET | {"multiline", "placeholder", "dynamic_prompts"},
}


class Interrupted(Exception):
    """As ComfyUI's InterruptProcessingException."""


@dataclass
class Port:
    id: str
    io_type: str
    options: dict[str, Any] = field(default_factory=dict)


def kind(io_type: str) -> SimpleNamespace:
    """A type of values, with ``Input`` and ``Output``."""

    def make_input(id: str, **options: Any) -> Port:
        unknown = set(options) - ACCEPTED.get(io_type, COMMON)
        assert not unknown, f"{io_type} takes no {unknown}"
        return Port(id, io_type, options)

    def make_output(id: str = "", display_name: str = "", tooltip: str = "", is_output_list: bool = False) -> Port:
        return Port(id or display_name, io_type)

    return SimpleNamespace(io_type=io_type, Input=make_input, Output=make_output)


@dataclass
class Schema:
    node_id: str
    display_name: str
    category: str
    inputs: list[Port] = field(default_factory=list)
    outputs: list[Port] = field(default_factory=list)
    description: str = ""
    is_output_node: bool = False


class ComfyNode:
    """Base of the nodes; a node is a class that is never instantiated."""

    def __init__(self) -> None:
        raise AssertionError("V3 nodes are not instantiated")


class NodeOutput:
    def __init__(self, *args: Any, ui: Any = None, expand: dict | None = None, block_execution: str | None = None):
        self.args, self.ui = args, ui


class FolderType(StrEnum):
    output = "output"


def install(monkeypatch, root: Path) -> SimpleNamespace:
    """Put the modules in place with input, output and temporary folders below ``root``; returns what they are told."""
    told = SimpleNamespace(progress=[], cancelled=False)
    for name in ("input", "output", "temp"):
        (root / name).mkdir()

    class Execution:
        @staticmethod
        def set_progress(value, max_value, node_id=None, preview_image=None, ignore_size_limit=False):
            told.progress.append((value, max_value, preview_image))

    def get_save_image_path(prefix: str, output_dir: str, image_width: int = 0, image_height: int = 0):
        folder = Path(output_dir) / Path(prefix).parent
        folder.mkdir(parents=True, exist_ok=True)
        count = len(list(folder.glob(f"{Path(prefix).name}_*"))) + 1
        return str(folder), Path(prefix).name, count, str(Path(prefix).parent), prefix

    def stop_if_cancelled() -> None:
        if told.cancelled:
            raise Interrupted

    io = SimpleNamespace(
        Schema=Schema, ComfyNode=ComfyNode, NodeOutput=NodeOutput, FolderType=FolderType, Custom=kind,
        UploadType=SimpleNamespace(model="file_upload"), Combo=kind("COMBO"), Float=kind("FLOAT"), Int=kind("INT"),
        Boolean=kind("BOOLEAN"), String=kind("STRING"), Image=kind("IMAGE"), File3DAny=kind("FILE_3D"),
    )  # fmt: skip
    ui = SimpleNamespace(
        PreviewImage=lambda image, animated=False, cls=None: {"images": image},
        PreviewText=lambda value: {"text": (value,)},
        SavedResult=lambda filename, subfolder, type: {
            "filename": filename,
            "subfolder": subfolder,
            "type": type.value,
        },
    )
    modules: dict[str, dict[str, Any]] = {
        "comfy_api": {},
        "comfy_api.latest": {
            "io": io, "ui": ui, "ComfyExtension": object, "ComfyAPISync": lambda: SimpleNamespace(execution=Execution),
        },
        "comfy": {},
        "comfy.model_management": {"throw_exception_if_processing_interrupted": stop_if_cancelled},
        "folder_paths": {
            "get_input_directory": lambda: str(root / "input"),
            "get_output_directory": lambda: str(root / "output"),
            "get_temp_directory": lambda: str(root / "temp"),
            "get_annotated_filepath": lambda name: str(root / "input" / name),
            "get_save_image_path": get_save_image_path,
        },
    }  # fmt: skip
    for name, content in modules.items():
        module = ModuleType(name)
        vars(module).update(content)
        monkeypatch.setitem(sys.modules, name, module)
        parent, _, child = name.rpartition(".")
        if parent:
            setattr(sys.modules[parent], child, module)
    return told

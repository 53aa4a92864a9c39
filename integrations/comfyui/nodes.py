"""The nodes, by ComfyUI's V3 schema (``comfy_api.latest``): load a mesh, refine it, look at it, save it, read numbers.

Between the nodes go two values: an asset, ``{"file": path, "up": axis or None}``, and a run, ``{"folder": path,
"name": text, "metrics": dict}``, whose folder holds what ``genmf-mi refine`` writes. Mitsuba and torch start with the
first refinement.
"""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args, get_type_hints

import folder_paths  # of ComfyUI
from comfy_api.latest import ComfyExtension, io, ui

from genmf_mi.assets.suffixes import MESHES
from genmf_mi.core.config import PRESETS, RefineConfig
from genmf_mi.core.printer import PRINTERS

from .progress import ComfyProgress

CATEGORY = "3d/genmf"
SAMPLE = "sample: "
"""Before the name of a bundled sample, in the list of files."""
FORMATS = {"3mf": "refined.3mf", "stl": "refined.stl", "glb": "refined.glb"}

Asset = io.Custom("GENMF_ASSET")
Run = io.Custom("GENMF_RUN")


class LoadTexturedMesh(io.ComfyNode):
    """A file of ComfyUI's input folder, a bundled sample, or what another node has made."""

    @classmethod
    def define_schema(cls) -> io.Schema:
        from genmf_mi.assets.samples import NAMES

        options = [*_inputs(), *(SAMPLE + name for name in NAMES)]
        return io.Schema(
            node_id="GenmfLoadTexturedMesh",
            display_name="Load Textured Mesh (genmf)",
            category=CATEGORY,
            description="A mesh with colours: a file, a bundled sample, or the 3D file of another node.",
            inputs=[
                io.Combo.Input(
                    "file", options=options, upload=io.UploadType.model, tooltip="Not used if a model is connected."
                ),
                io.Combo.Input(
                    "up",
                    options=["auto", "y", "-y", "z", "-z", "x", "-x"],
                    default="auto",
                    tooltip="The axis that points upwards.",
                ),
                io.File3DAny.Input(
                    "model", optional=True, tooltip="The 3D file of another node, in place of the file."
                ),
            ],
            outputs=[Asset.Output(display_name="asset")],
        )

    @classmethod
    def fingerprint_inputs(cls, file: str, up: str = "auto", model: Any = None) -> str:
        """Another value when the file has changed, so that ComfyUI loads it again."""
        path = _path(file)
        return f"{file} {up} {path.stat().st_mtime_ns if path.is_file() else ''}"

    @classmethod
    def validate_inputs(cls, file: str, up: str = "auto", model: Any = None) -> bool | str:
        """Whether the file is there; ComfyUI shows the text otherwise."""
        return True if file.startswith(SAMPLE) or _path(file).is_file() else f"there is no file {file}"

    @classmethod
    def execute(cls, file: str, up: str = "auto", model: Any = None) -> io.NodeOutput:
        source = file.removeprefix(SAMPLE) if file.startswith(SAMPLE) else str(_path(file))
        if model is not None:
            path = Path(folder_paths.get_temp_directory()) / f"genmf_{id(model):x}.{model.format or 'glb'}"
            source = str(model.save_to(str(path)))
        return io.NodeOutput({"file": source, "up": None if up == "auto" else up})


class RefineRelief(io.ComfyNode):
    """The refinement; its settings are those of ``genmf-mi refine``, of which the preset sets the rest."""

    @classmethod
    def define_schema(cls) -> io.Schema:
        default = RefineConfig()
        return io.Schema(
            node_id="GenmfRefineRelief",
            display_name="Refine Relief (genmf)",
            category=CATEGORY,
            description="Turns a textured mesh into a one-colour part whose relief shows the texture.",
            inputs=[
                Asset.Input("asset"),
                io.Combo.Input(
                    "preset",
                    options=list(PRESETS),
                    default="default",
                    tooltip="draft is a quick look; paper takes long.",
                ),
                io.Float.Input(
                    "size_mm",
                    default=default.size_mm,
                    min=10.0,
                    max=1000.0,
                    step=1.0,
                    tooltip="Longest side of the part.",
                ),
                io.Float.Input(
                    "max_relief_mm",
                    default=default.max_relief_mm,
                    min=0.1,
                    max=5.0,
                    step=0.05,
                    tooltip="No point moves by more.",
                ),
                io.Float.Input("nozzle_mm", default=default.nozzle_mm, min=0.05, max=2.0, step=0.05, advanced=True),
                io.Combo.Input(
                    "printer",
                    options=list(PRINTERS),
                    default=default.printer,
                    tooltip="smooth for resin and casts; fdm-* for filament in layers.",
                ),
                io.Combo.Input(
                    "stand", options=_choices("stand"), default=default.stand, tooltip="Which way up it is printed."
                ),
                io.Combo.Input("material", options=_choices("material"), default=default.material, advanced=True),
                io.Combo.Input("method", options=_choices("method"), default=default.method, advanced=True),
                io.Int.Input("iterations", default=0, min=0, max=5000, tooltip="0: as many as the preset has."),
                io.Boolean.Input(
                    "stress", default=True, tooltip="Keep the thermal stress down. The draft preset never does."
                ),
                io.Float.Input(
                    "grain",
                    default=default.grain,
                    min=0.0,
                    max=1.0,
                    step=0.01,
                    advanced=True,
                    tooltip="Contrast of texture that is left out as grain.",
                ),
                io.Int.Input("seed", default=default.seed, min=0, max=2**31 - 1),
                io.Combo.Input("device", options=_choices("device"), default=default.device, advanced=True),
            ],
            outputs=[Run.Output(display_name="run"), io.Image.Output(display_name="before_after")],
        )

    @classmethod
    def execute(
        cls, asset: dict[str, Any], preset: str, iterations: int, stress: bool, **settings: Any
    ) -> io.NodeOutput:
        import genmf_mi

        config = replace(PRESETS[preset], **settings)
        config = replace(config, iterations=iterations or config.iterations, stress=stress and config.stress)
        name = Path(asset["file"]).stem
        folder = _new_folder(name)
        progress = ComfyProgress(folder)
        result = genmf_mi.refine(asset["file"], config, up=asset["up"], out=folder, progress=progress)
        run = {"folder": str(folder), "name": name, "metrics": result.metrics}
        return io.NodeOutput(run, _picture(folder / "before_after.png"))


class PreviewBeforeAfter(io.ComfyNode):
    """Textured, printed as it is, refined: the picture of a run, shown on the node."""

    @classmethod
    def define_schema(cls) -> io.Schema:
        return io.Schema(
            node_id="GenmfPreviewBeforeAfter",
            display_name="Preview Before/After (genmf)",
            category=CATEGORY,
            inputs=[Run.Input("run")],
            outputs=[io.Image.Output(display_name="image")],
            is_output_node=True,
        )

    @classmethod
    def execute(cls, run: dict[str, Any]) -> io.NodeOutput:
        image = _picture(Path(run["folder"]) / "before_after.png")
        return io.NodeOutput(image, ui=ui.PreviewImage(image, cls=cls))


class SavePart(io.ComfyNode):
    """The part as a file of ComfyUI's output folder: millimetres and z up for printing, or GLB with the colours."""

    @classmethod
    def define_schema(cls) -> io.Schema:
        return io.Schema(
            node_id="GenmfSavePart",
            display_name="Save Part (genmf)",
            category=CATEGORY,
            inputs=[
                Run.Input("run"),
                io.Combo.Input("format", options=list(FORMATS), default="3mf"),
                io.String.Input("filename_prefix", default="genmf/part"),
            ],
            outputs=[io.String.Output(display_name="file")],
            is_output_node=True,
        )

    @classmethod
    def execute(cls, run: dict[str, Any], format: str, filename_prefix: str) -> io.NodeOutput:
        folder, name, count, subfolder, _ = folder_paths.get_save_image_path(
            filename_prefix, folder_paths.get_output_directory()
        )
        file = Path(folder) / f"{name}_{count:05}_.{format}"
        shutil.copyfile(Path(run["folder"]) / FORMATS[format], file)
        shown = [ui.SavedResult(file.name, subfolder, io.FolderType.output)]
        return io.NodeOutput(str(file), ui={"3d": shown})


class Report(io.ComfyNode):
    """The numbers of a run as text, and where its report lies."""

    @classmethod
    def define_schema(cls) -> io.Schema:
        return io.Schema(
            node_id="GenmfReport",
            display_name="Report (genmf)",
            category=CATEGORY,
            inputs=[Run.Input("run")],
            outputs=[
                io.String.Output(display_name="text"),
                io.String.Output(display_name="html_file"),
                io.String.Output(display_name="metrics"),
            ],
            is_output_node=True,
        )

    @classmethod
    def execute(cls, run: dict[str, Any]) -> io.NodeOutput:
        metrics, report = run["metrics"], Path(run["folder"]) / "report.html"
        before, after, relief = metrics["before"], metrics["after"], metrics["relief_mm"]
        lines = [f"{run['name']}: relief at most {relief['max']:.2f} mm, mean {relief['mean']:.2f} mm"]
        for key, label in (("lpips_alex", "LPIPS"), ("ssim", "SSIM"), ("g_ssim", "g-SSIM")):
            lines.append(f"{label}: {before[key]:.3f} -> {after[key]:.3f}")
        lines.append(f"report: {report}")
        text = "\n".join(lines)
        return io.NodeOutput(text, str(report), json.dumps(metrics), ui=ui.PreviewText(text))


class GenmfExtension(ComfyExtension):
    """What ComfyUI loads."""

    async def get_node_list(self) -> list[type[io.ComfyNode]]:
        return [LoadTexturedMesh, RefineRelief, PreviewBeforeAfter, SavePart, Report]


async def comfy_entrypoint() -> GenmfExtension:
    """Called by ComfyUI when it starts."""
    return GenmfExtension()


def _choices(setting: str) -> list[str]:
    """The words that a setting can be."""
    return list(get_args(get_type_hints(RefineConfig)[setting]))


def _inputs() -> list[str]:
    """The meshes in ComfyUI's input folder and below, as paths relative to it."""
    root = Path(folder_paths.get_input_directory())
    return sorted(path.relative_to(root).as_posix() for path in root.rglob("*") if path.suffix.lower() in MESHES)


def _path(file: str) -> Path:
    return Path(folder_paths.get_annotated_filepath(file))


def _new_folder(name: str) -> Path:
    """A folder for a run below ComfyUI's output folder, with a number that is not taken."""
    root = Path(folder_paths.get_output_directory()) / "genmf"
    taken = {path.name for path in root.glob(f"{name}_*")}
    return root / next(f"{name}_{i:05}" for i in range(1, 10**5) if f"{name}_{i:05}" not in taken)


def _picture(file: Path) -> Any:
    """An image as ComfyUI passes it on: float32 ``[1,H,W,3]``, 0..1."""
    import numpy as np
    import torch
    from PIL import Image

    pixels = np.asarray(Image.open(file).convert("RGB"), dtype=np.float32) / 255
    return torch.from_numpy(pixels)[None]

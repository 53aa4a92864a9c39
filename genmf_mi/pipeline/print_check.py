"""Print a part before it is printed: ``genmf-mi print-check PART``."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL.Image import Image
from torch import Tensor

from genmf_mi.assets import samples
from genmf_mi.assets.asset import Asset, load
from genmf_mi.core.config import RefineConfig
from genmf_mi.core.errors import ConfigError
from genmf_mi.core.frame import UPRIGHT, Frame, Up
from genmf_mi.core.printer import PRINTERS, Printer
from genmf_mi.core.progress import Progress
from genmf_mi.fabrication.files import COLOURED_GLB
from genmf_mi.losses import lpips_conversion
from genmf_mi.mesh import topology
from genmf_mi.pipeline.as_printed import LAMPS, PAINTED, TWO_LIGHTS, Pictures, PrintedViews, PrintGate, paint_of, scores
from genmf_mi.pipeline.evaluation import WELD
from genmf_mi.pipeline.problem import RefinementProblem, build_problem, standing
from genmf_mi.pipeline.run_folder import RunFolder
from genmf_mi.pipeline.scoring import Scorer
from genmf_mi.printing import slicer as slicers
from genmf_mi.render import scene_file, variant
from genmf_mi.report.pictures import compose, plastic, write_rows

DEFAULT_PRINTER = "fdm-0.2"
Shapes = Mapping[str, tuple[np.ndarray, np.ndarray]]
"""By name: vertices ``[V,3]`` in the normalised frame and faces ``[F,3]``."""
LIGHTS = {TWO_LIGHTS: "in even light", LAMPS: "under lamps, with shadows"}
NAMES = {"before": "printed as it is", "displacement": "best displacement", "after": "refined"}


@dataclass(frozen=True)
class PrintCheck:
    """What comes off the printer.

    metrics: ``printer``, ``slicer``, under ``parts`` the reports of :class:`genmf_mi.printing.printed.Printed` by name,
        and where there is a texture :func:`genmf_mi.pipeline.as_printed.scores` by lighting.
    rows: of pictures, by what is said beside them.
    """

    metrics: dict[str, Any]
    rows: dict[str, list[Image]]
    names: list[str]

    def write(self, path: Path) -> None:
        """The pictures as one PNG. Raises :class:`OutputError`."""
        write_rows(path, self.rows, self.names)


def printer_named(name: str) -> Printer:
    """One of the :data:`PRINTERS` with layers that can be seen. Raises :class:`ConfigError`."""
    printer = PRINTERS.get(name)
    if printer is None or not printer.layered:
        layered = ", ".join(key for key, value in PRINTERS.items() if value.layered)
        raise ConfigError(f"there is nothing to look at before printing with {name}: choose one of {layered}.")
    return printer


@dataclass(frozen=True)
class PartToPrint:
    """A file with a part in the pose of the textured asset, how it is printed, and what belongs to its target."""

    path: Path
    printer: str = DEFAULT_PRINTER
    size_mm: float = 100.0
    up: Up = UPRIGHT
    target: RefineConfig = field(default_factory=RefineConfig)

    @classmethod
    def of(cls, part: str | Path) -> PartToPrint:
        """A file, which is printed upright, or the part of a run's folder as the run meant it.

        Raises:
            ConfigError: the run is not complete. OutputError: its files are damaged.
        """
        path = Path(part)
        if not path.is_dir():
            return cls(samples.resolve(part))
        run = RunFolder(path)
        metrics = run.metrics()
        if metrics is None:
            raise ConfigError(f"there is no complete run in {path}: give the folder of one, or a file.")
        settings = run.settings()
        printer = str(settings.get("printer"))
        x, y, z = metrics.get("stand", {}).get("up", UPRIGHT)
        layered = printer in PRINTERS and PRINTERS[printer].layered
        chosen = printer if layered else DEFAULT_PRINTER
        target = replace(
            RefineConfig(),
            normal_map=bool(settings.get("normal_map", RefineConfig.normal_map)),
            occlusion_map=bool(settings.get("occlusion_map", RefineConfig.occlusion_map)),
            emissive_map=bool(settings.get("emissive_map", RefineConfig.emissive_map)),
        )
        return cls(path / COLOURED_GLB, chosen, float(settings["size_mm"]), (x, y, z), target)


def check_shapes(
    problem: RefinementProblem,
    shapes: Shapes,
    printer_name: str,
    slicer: str,
    xml: Path,
    folder: Path,
    progress: Progress,
) -> PrintCheck:
    """Print the shapes of a refinement, ``before`` among them, and score them against its texture.

    folder: for passing files.
    """
    program = slicers.find(slicer)
    if program is None and slicer == "auto":
        progress.warn(f"there is no slicer on this machine, so a simpler one of our own is used. {slicers.INSTALL}")
    radius = float(np.linalg.norm(problem.surface.vertices, axis=1).max())
    gate = PrintGate(problem.frame, radius, printer_named(printer_name), program, xml, folder, progress)
    paint = paint_of(problem)
    parts = {name: gate.look(name, *shape, paint if name == "before" else None) for name, shape in shapes.items()}
    progress.stage("scoring as printed")
    metrics = {**_said(parts, printer_name), **scores(parts, wanted=_wanted(problem))}
    painted = {light: parts["before"].pictures[light + PAINTED] for light in LIGHTS}
    index = Scorer(painted[TWO_LIGHTS].grey, painted[TWO_LIGHTS].coverage, ()).most_telling
    rows = {
        label: [
            _shown(pictures, index, _exposure(parts["before"], light))
            for pictures in (painted[light], *(part.pictures[light] for part in parts.values()))
        ]
        for light, label in LIGHTS.items()
    }
    return PrintCheck(metrics, rows, ["painted", *(NAMES.get(name, name) for name in parts)])


def print_check(
    part: str | Path | Asset,
    textured: str | Path | Asset | None = None,
    *,
    printer: str | None = None,
    slicer: str = "auto",
    size_mm: float | None = None,
    scene: str | Path | None = None,
    progress: Progress | None = None,
) -> PrintCheck:
    """Slice a part, look at every bead, and score the look against the textured asset.

    Args:
        part: a closed one-colour shape, in the pose of the textured asset, or the folder of a run, whose part is
            printed the way up that the run chose; print files are turned upright.
        textured: what it should look like; None only slices and looks.
        printer: one of :data:`genmf_mi.core.printer.PRINTERS` that works in layers; that of the run, or
            :data:`DEFAULT_PRINTER`, if None.
        slicer: ``auto`` for the one that is installed, ``own`` for ours, or a program.
        size_mm: longest side of the part; that of the run, or 100, if None.
        scene: scene file; the sample's own or ``default.xml`` if None.

    Raises:
        GenmfError: as :func:`genmf_mi.refine` and :func:`genmf_mi.printing.printed.print_part`.
    """
    variant.use("auto")
    progress = progress or Progress()
    told = PartToPrint(Path()) if isinstance(part, Asset) else PartToPrint.of(part)
    printer, size_mm = printer or told.printer, size_mm or told.size_mm
    chosen, program = printer_named(printer), slicers.find(slicer)
    shape = part if isinstance(part, Asset) else load(told.path)
    vertices, faces = topology.weld(shape.vertices, shape.faces, WELD * np.ptp(shape.vertices, axis=0).max())
    frame = Frame.of(vertices, size_mm).standing(told.up)
    vertices = frame.normalise(vertices)
    with tempfile.TemporaryDirectory(prefix="genmf-") as folder:
        if textured is None:
            xml = Path(scene) if scene else scene_file.find(shape.name)
            radius = float(np.linalg.norm(vertices, axis=1).max())
            gate = PrintGate(frame, radius, chosen, program, xml, Path(folder), progress)
            parts = {"part": gate.look("part", vertices, faces)}
            rows = {
                label: [_shown(parts["part"].pictures[light], 0, _exposure(parts["part"], light))]
                for light, label in LIGHTS.items()
            }
            return PrintCheck(_said(parts, printer), rows, ["as printed"])
        lpips_conversion.ensure("alex", progress=progress)
        asset = textured if isinstance(textured, Asset) else load(samples.resolve(textured))
        xml = Path(scene) if scene else scene_file.find(asset.name)
        progress.stage("preparing the textured object")
        config = replace(told.target, size_mm=size_mm)
        problem = standing(build_problem(asset, config, xml, Path(folder)), told.up, config)
        surface = problem.surface
        shapes = {"before": (surface.vertices, surface.faces), "after": (vertices, faces)}
        return check_shapes(problem, shapes, printer, slicer, xml, Path(folder), progress)


def _wanted(problem: RefinementProblem) -> Tensor | None:
    """Where relief is wanted in the standard views, at the resolution of the scores; None if everywhere."""
    if problem.region_images is None:
        return None
    pair = problem.evaluation
    pair.reference.scene.shade_as(pair.part)
    return problem.region_images.emphasis(pair.reference.views).wanted


def _said(parts: Mapping[str, PrintedViews], printer: str) -> dict[str, Any]:
    slicer = next(iter(parts.values())).printed.slicer
    return {"printer": printer, "slicer": slicer, "parts": {name: part.printed.report for name, part in parts.items()}}


def _exposure(part: PrintedViews, light: str) -> float:
    """By how much a picture in ``light`` is brightened, so that the part is as bright in it as in even light."""
    return float(part.pictures[TWO_LIGHTS].grey.sum() / part.pictures[light].grey.sum().clamp_min(1e-6))


def _shown(pictures: Pictures, index: int, exposure: float) -> Image:
    grey, coverage = (x[index, 0].cpu().numpy() for x in (pictures.grey, pictures.coverage))
    return compose(plastic(exposure * grey), coverage)

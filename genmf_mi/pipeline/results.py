"""What a refinement leaves behind: scores, checks and files."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL.Image import Image
from torch import Tensor

from genmf_mi.core import memory
from genmf_mi.core.config import RefineConfig
from genmf_mi.core.progress import Progress
from genmf_mi.core.timer import Timer
from genmf_mi.fabrication import files
from genmf_mi.fabrication.checks import check, pieces
from genmf_mi.geometry.parameterization import RefinedSurface
from genmf_mi.geometry.plain_areas import is_plain
from genmf_mi.mesh.measures import vertex_areas
from genmf_mi.pipeline import regions
from genmf_mi.pipeline.build_direction import Candidate
from genmf_mi.pipeline.displacement import Displacement
from genmf_mi.pipeline.evaluator import Evaluator, unseen_views
from genmf_mi.pipeline.print_check import PrintCheck
from genmf_mi.pipeline.problem import RefinementProblem
from genmf_mi.pipeline.run_folder import AS_PRINTED, BEFORE_AFTER, EXR, REPORT, RunFolder
from genmf_mi.pipeline.surface import seen_at, signals
from genmf_mi.render import bridge
from genmf_mi.render.exr import write_buffers
from genmf_mi.report import Report, View, write_before_after, write_report
from genmf_mi.report.regions import region_picture

Shapes = dict[str, tuple[Tensor, Tensor]]
"""By name: vertices ``[V,3]`` in the normalised frame and faces ``[F,3]``."""


@dataclass(frozen=True)
class Result:
    """A refined part.

    vertices_mm ``[V,3]``: on the print bed, z up, base on z = 0. vertices ``[V,3]``: in the asset's own units, y up.
    faces ``[F,3]``. rgb ``[V,3]``: linear colour of the original at each vertex. relief_mm ``[V]``: signed, positive
    where raised.
    metrics: as in ``metrics.json``. history: one dict per iteration. out: the folder written to, if any.
    """

    vertices_mm: np.ndarray
    vertices: np.ndarray
    faces: np.ndarray
    rgb: np.ndarray
    relief_mm: np.ndarray
    metrics: dict[str, Any]
    history: list[dict[str, Any]]
    out: Path | None


@dataclass(frozen=True)
class Outcome:
    """All that the optimisation hands over.

    stress_stage_left_out: why there was no stress stage although it was asked for, empty otherwise.
    verification: of the stress, empty if it was not asked for; unconstrained: the surface without the stress stage.
    stands: the ways to stand that were looked at, the best one first; empty if one was given.
    printed: what comes off the printer, if that was asked for.
    """

    problem: RefinementProblem
    config: RefineConfig
    evaluator: Evaluator
    displacement: Displacement
    surface: RefinedSurface
    history: list[dict[str, Any]]
    interrupted: bool
    stress_stage_left_out: str
    verification: dict[str, Any]
    unconstrained: tuple[np.ndarray, np.ndarray] | None
    stands: list[Candidate] = field(default_factory=list[Candidate])
    printed: PrintCheck | None = None

    @property
    def relief_mm(self) -> np.ndarray:
        """``[V]`` along the normals of the initial surface, positive where raised."""
        along = np.einsum("vk,vk->v", self.surface.offsets, self.surface.normals)
        return along * self.problem.frame.mm_per_unit

    @property
    def rgb(self) -> np.ndarray:
        """``[V,3]`` linear colour of the original at each vertex, in full light."""
        return self._seen[0]

    @property
    def signals(self) -> np.ndarray:
        """What is seen of the original at each vertex, see :func:`genmf_mi.pipeline.surface.signals`."""
        return signals(*self._seen)

    @cached_property
    def _seen(self) -> tuple[np.ndarray, np.ndarray | None]:
        foot = self.problem.frame.restore(self.surface.foot)
        return seen_at(self.problem.asset, foot, self.surface.normals)


def conclude(
    outcome: Outcome, run: RunFolder | None, timer: Timer, progress: Progress, *, save_exr: bool = False
) -> Result:
    """Score, check and, where there is a run folder, write everything.

    Raises:
        OutputError: a file cannot be written.
    """
    problem, surface, rgb = outcome.problem, outcome.surface, outcome.rgb
    with ThreadPoolExecutor(1) as beside:
        writing = beside.submit(write_part, outcome, run.path, rgb) if run else None
        scores, buffers = scores_of(outcome, shapes_of(outcome), progress)
    timer.lap("evaluate")

    progress.stage("checking the part")
    part_mm = problem.frame.to_print(surface.vertices)
    metrics = metrics_of(outcome, scores, part_mm)
    _warn(metrics, progress)
    result = Result(
        vertices_mm=part_mm,
        vertices=problem.frame.restore(surface.vertices),
        faces=surface.faces,
        rgb=rgb,
        relief_mm=outcome.relief_mm,
        metrics=metrics,
        history=outcome.history,
        out=run.home(interrupted=outcome.interrupted) if run else None,
    )
    if run is not None and writing is not None:
        progress.stage("writing the files")
        written = writing.result()
        metrics["files"] = {kind: str((result.out or run.path) / Path(file).name) for kind, file in written.items()}
        # The report tells the time too, so far as it is known
        metrics["seconds"] = {"total": timer.total, **timer.seconds}
        write_pictures(outcome, run.path, buffers, rgb, metrics, save_exr=save_exr)
    timer.lap("write")
    metrics["seconds"] = {"total": timer.total, **timer.seconds}
    metrics["peak_memory_gb"] = memory.peak_gb()
    if run is not None:
        run.finish(metrics)
    return result


def write_part(outcome: Outcome, folder: Path, rgb: np.ndarray) -> dict[str, str]:
    """See :func:`genmf_mi.fabrication.files.write`; it runs beside the scoring."""
    surface, problem = outcome.surface, outcome.problem
    return files.write(folder, surface.vertices, surface.faces, problem.frame, rgb, problem.asset.name)


def shapes_of(outcome: Outcome) -> Shapes:
    """The part before, displaced by brightness, without the stress stage if there is that, and after."""
    initial, surface = outcome.problem.surface, outcome.surface
    displaced = initial.vertices + outcome.displacement.heights[:, None] * initial.normals
    surfaces = {"before": (initial.vertices, initial.faces), "displacement": (displaced, initial.faces)}
    if outcome.unconstrained is not None:
        surfaces["unconstrained"] = outcome.unconstrained
    surfaces["after"] = (surface.vertices, surface.faces)
    device = outcome.evaluator.device
    return {
        name: (torch.as_tensor(v, dtype=torch.float32, device=device), torch.as_tensor(f, device=device))
        for name, (v, f) in surfaces.items()
    }


def scores_of(outcome: Outcome, shapes: Shapes, progress: Progress) -> tuple[dict[str, Any], dict[str, bridge.Buffers]]:
    """Scores of the shapes by name on the standard views and, under ``unseen``, on the unseen ones; and the images of
    the shapes in the standard views."""
    scorer = outcome.evaluator
    progress.stage("scoring")
    buffers = {name: scorer.render(*shape) for name, shape in shapes.items()}
    table = scorer.verdicts(buffers)
    if not scorer.reference.pictures:
        progress.stage("scoring, unseen views")
        memory.trim_malloc()
        unseen = replace(scorer, views=unseen_views(scorer.views))
        table["unseen"] = unseen.verdicts({name: unseen.render(*shape) for name, shape in shapes.items()})
    return table, buffers


def metrics_of(outcome: Outcome, scores: dict[str, Any], part_mm: np.ndarray) -> dict[str, Any]:
    """The contents of ``metrics.json`` but for files, seconds and memory."""
    problem, surface = outcome.problem, outcome.surface
    distance = np.linalg.norm(surface.offsets, axis=1) * problem.frame.mm_per_unit
    report = dict(surface.report)
    backed_off = report.pop("relief_backed_off", 0.0)
    metrics = {
        "asset": problem.asset.name,
        **scores,
        "relief_mm": {
            "max": float(distance.max()),
            "p99": float(np.percentile(distance, 99)),
            "mean": float(distance.mean()),
        },
        "plain_distortion_mm": plain_distortion(outcome, distance),
        "contrast": problem.contrast,
        "cap_mm": problem.cap_mm,
        "stand": stood(outcome),
        "displacement_amplitude": outcome.displacement.amplitude,
        "relief_backed_off": backed_off,
        "solid": {**problem.report, **report, **check(part_mm, surface.faces)},
        "nonfinite_gradients": sum(record.get("nonfinite_gradients", 0) for record in outcome.history),
    }
    if apart := pieces(part_mm, surface.faces):
        metrics["pieces"] = apart
    if problem.asset.notes:
        metrics["asset_notes"] = list(problem.asset.notes)
    if problem.regions is not None:
        metrics["regions"] = regions.told(
            problem.regions, problem.surface.vertices, problem.surface.faces, surface.foot, distance, problem.frame
        ) | {"fade_mm": outcome.config.mask_fade_mm}
    if outcome.verification:
        metrics["stress"] = outcome.verification
    if outcome.printed:
        metrics["as_printed"] = outcome.printed.metrics
    if outcome.stress_stage_left_out:
        metrics["stress_stage_left_out"] = outcome.stress_stage_left_out
    return metrics | {"iterations": len(outcome.history), "interrupted": outcome.interrupted}


def region_pictures(outcome: Outcome, before: bridge.Buffers) -> dict[str, Image]:
    """What was painted on the part, by standard view; ``before`` shows it as it was."""
    images, scorer = outcome.problem.region_images, outcome.evaluator
    if images is None:
        return {}
    scorer.reference.scene.shade_as(scorer.scene)
    coverage = before.geometry[2]
    return {
        view.label: region_picture(before.grey[i, 0].cpu().numpy(), coverage[i, 0].cpu().numpy(), *(m[i] for m in maps))
        for maps in [images.maps(scorer.views)]
        for i, view in enumerate(scorer.views)
    }


def stood(outcome: Outcome) -> dict[str, Any]:
    """Which way up the part is printed: its name and ``up``, away from the bed, in the normalised frame; ``asked``, if
    that was ``auto``; ``unsteady``, if nothing flat of it lies on the bed; and under ``candidates`` what was looked at
    to find it."""
    pose = outcome.problem.pose
    found: dict[str, Any] = {"name": pose.name, "up": list(pose.up)}
    found |= {"asked": pose.asked} if pose.asked == "auto" else {}
    found |= {"unsteady": True} if pose.unsteady else {}
    return found | ({"candidates": [asdict(each) for each in outcome.stands]} if outcome.stands else {})


def plain_distortion(outcome: Outcome, distance_mm: np.ndarray) -> dict[str, float]:
    """How far plain areas moved: mean, 95th percentile and maximum in mm, and their share of the surface; zeros where
    the object has no plain areas."""
    surface, frame = outcome.surface, outcome.problem.frame
    plain = is_plain(surface.foot * frame.mm_per_unit, outcome.signals)
    moved = distance_mm[plain] if plain.any() else np.zeros(1)
    area = vertex_areas(surface.foot, surface.faces)
    return {
        "mean": float(moved.mean()),
        "p95": float(np.percentile(moved, 95)),
        "max": float(moved.max()),
        "share": float(area[plain].sum() / area.sum()),
    }


def write_pictures(
    outcome: Outcome,
    folder: Path,
    buffers: dict[str, bridge.Buffers],
    rgb: np.ndarray,
    metrics: dict[str, Any],
    *,
    save_exr: bool,
) -> None:
    """``before_after.png``, ``report.html`` and, on request, the buffers of every shape and view as OpenEXR."""
    problem, surface, scorer = outcome.problem, outcome.surface, outcome.evaluator
    # The scene still holds the refined shape, which was rendered last
    relief = bridge.render_vertex_values(scorer.scene, scorer.views, surface.faces, outcome.relief_mm)
    colour = scorer.render_colour(scorer.views)

    def image(name: str, channel: str, i: int) -> np.ndarray:
        return getattr(buffers[name], channel)[i, 0].cpu().numpy()

    views = [
        View(
            label=view.label,
            mask=image("before", "coverage", i),
            colour=colour[i],
            reference=scorer.target_grey[i, 0].cpu().numpy(),
            before=image("before", "grey", i),
            displacement=image("displacement", "grey", i),
            after=image("after", "grey", i),
            relief_mm=relief[i],
            displacement_mask=image("displacement", "coverage", i),
            after_mask=image("after", "coverage", i),
        )
        for i, view in enumerate(scorer.views)
    ]
    write_before_after(folder / BEFORE_AFTER, views, problem.asset.name)
    if outcome.printed:
        outcome.printed.write(folder / AS_PRINTED)
    report = Report(
        title=problem.asset.name,
        views=views,
        history=outcome.history,
        metrics=metrics,
        config=outcome.config.to_dict(),
        vertices=surface.vertices,
        faces=surface.faces,
        colours=rgb,
        relief_mm=outcome.relief_mm,
        cap_mm=outcome.config.max_relief_mm * (1.0 if problem.regions is None else float(problem.regions.cap.max())),
        size_mm=outcome.config.size_mm,
        material=scorer.scene.material,
        steps=problem.report,
        original=surface.foot,
        as_printed=outcome.printed.rows if outcome.printed else {},
        as_printed_names=outcome.printed.names if outcome.printed else [],
        regions=region_pictures(outcome, buffers["before"]),
    )
    write_report(folder / REPORT, report)
    if save_exr:
        for name, shape in buffers.items():
            write_buffers(folder / EXR / name, scorer.views, shape)


BACKED_OFF = 0.01
"""Share of the surface from which on it is worth a warning that relief was taken back."""


def _warn(metrics: dict[str, Any], progress: Progress) -> None:
    share = metrics["relief_backed_off"]
    if share > BACKED_OFF:
        progress.warn(f"relief was taken back on {share:.0%} of the surface, where it would have cut through itself")
    if count := metrics["nonfinite_gradients"]:
        progress.warn(f"{count} entries of the gradients were not finite and counted as 0: please report the asset")

"""What a refinement leaves behind: scores, checks, files."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from genmf_mi.core import memory
from genmf_mi.pipeline.evaluation import Evaluator, unseen
from genmf_mi.render import bridge

if TYPE_CHECKING:
    from torch import Tensor

    from genmf_mi.geometry.parameterization import RefinedSurface
    from genmf_mi.pipeline.refinement import _Job
    from genmf_mi.pipeline.run_folder import Run


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
    metrics: dict
    history: list[dict]
    out: Path | None


Shapes = dict[str, "tuple[Tensor, Tensor]"]
"""By name: vertices ``[V,3]`` in the normalised frame and faces ``[F,3]``."""


def scores(job: _Job, shapes: Shapes) -> dict:
    """Scores of named shapes on the standard views and, under ``unseen``, on the unseen ones."""
    piece, table = job.piece, {}
    judges = {"": job.judge}
    if not piece.reference.pictures:
        judges["unseen"] = Evaluator(
            piece.judged_reference, piece.judged_part, unseen(job.judge.views), job.judge.networks
        )
    for group, judge in judges.items():
        job.listener.say(f"scoring{', unseen views' if group else ''}")
        rows = judge.scores({name: judge.render(*shape) for name, shape in shapes.items()})
        table |= {group: rows} if group else rows
    return table


def conclude(
    job: _Job,
    run: Run | None,
    refined: RefinedSurface,
    seconds: dict,
    started: float,
    interrupted: bool,
    save_exr: bool,
) -> Result:
    """Score, check and, where there is a run folder, write everything."""
    import torch

    from genmf_mi.pipeline import fabrication as fabricate

    piece, say = job.piece, job.listener.say
    displaced = piece.vertices + job.displaced[:, None] * piece.normals
    surfaces = {"before": (piece.vertices, piece.faces), "displacement": (displaced, piece.faces)}
    if job.without_stress is not None:
        surfaces["unconstrained"] = job.without_stress
    surfaces["after"] = (refined.vertices, refined.faces)
    shapes = {
        name: (torch.as_tensor(v, dtype=torch.float32, device=job.device), torch.as_tensor(f, device=job.device))
        for name, (v, f) in surfaces.items()
    }
    relief_mm = np.einsum("vk,vk->v", refined.offsets, refined.normals) * piece.frame.mm_per_unit
    rgb = piece.asset.closest_albedo(piece.frame.restore(refined.foot), refined.normals)

    table = scores(job, shapes)
    seconds["evaluate"] = job.lap()

    say("checking the part")
    distance = np.linalg.norm(refined.offsets, axis=1) * piece.frame.mm_per_unit
    part_mm = piece.frame.to_print(refined.vertices)
    metrics = {
        "asset": piece.asset.name,
        **table,
        "relief_mm": {
            "max": float(distance.max()),
            "p99": float(np.percentile(distance, 99)),
            "mean": float(distance.mean()),
        },
        "contrast": piece.contrast,
        "cap_mm": piece.cap_mm,
        "displacement_amplitude": job.amplitude,
        "solid": {**piece.report, **refined.report, **fabricate.check(part_mm, refined.faces)},
        **({"stress": job.verdict} if job.verdict else {}),
        **({"stress_stage_left_out": job.left_out} if job.left_out else {}),
        "iterations": len(job.history),
        "interrupted": interrupted,
    }
    result = Result(
        vertices_mm=part_mm,
        vertices=piece.frame.restore(refined.vertices),
        faces=refined.faces,
        rgb=rgb,
        relief_mm=relief_mm,
        metrics=metrics,
        history=job.history,
        out=run.folder if run else None,
    )
    if run:
        say("writing the files")
        files = fabricate.write(run.folder, refined.vertices, refined.faces, piece.frame, rgb, piece.asset.name)
        metrics["files"] = files
        write_pictures(job, run.folder, refined, shapes, rgb, relief_mm, metrics, save_exr)
    seconds["write"] = job.lap()
    metrics["seconds"] = {"total": time.perf_counter() - started, **seconds}
    metrics["peak_memory_gb"] = memory.peak_gb()
    if run:
        run.finish(metrics)
    return result


def write_pictures(
    job: _Job,
    folder: Path,
    refined: RefinedSurface,
    shapes: Shapes,
    rgb: np.ndarray,
    relief_mm: np.ndarray,
    metrics: dict,
    save_exr: bool,
) -> None:
    """``before_after.png``, ``report.html`` and, on request, the buffers of every shape and view as OpenEXR."""
    from genmf_mi.report import Report, View, write_before_after, write_report

    piece, judge = job.piece, job.judge
    shown = {name: judge.look(*shape) for name, shape in shapes.items()}
    grey, mask = (
        {name: getattr(b, channel)[:, 0].cpu().numpy() for name, b in shown.items()} for channel in ("grey", "coverage")
    )
    # The scene still holds the refined shape, which was rendered last
    relief = bridge.picture_of(judge.scene, judge.views, refined.faces, relief_mm)
    colour = piece.judged_reference.colour(judge.views)
    views = [
        View(
            label=view.label,
            mask=mask["before"][i],
            colour=colour[i],
            reference=judge.seen[i, 0].cpu().numpy(),
            before=grey["before"][i],
            displacement=grey["displacement"][i],
            after=grey["after"][i],
            relief_mm=relief[i],
            displacement_mask=mask["displacement"][i],
            after_mask=mask["after"][i],
        )
        for i, view in enumerate(judge.views)
    ]
    write_before_after(folder / "before_after.png", views, piece.asset.name)
    write_report(
        folder / "report.html",
        Report(
            title=piece.asset.name,
            views=views,
            history=job.history,
            metrics=metrics,
            config=job.config.to_dict(),
            vertices=refined.vertices,
            faces=refined.faces,
            colours=rgb,
            relief_mm=relief_mm,
            cap_mm=job.config.max_relief_mm,
            size_mm=job.config.size_mm,
            material=judge.scene.material,
            steps=piece.report,
            original=refined.foot,
        ),
    )
    if save_exr:
        from genmf_mi.render.exr import write_buffers

        for name, buffers in shown.items():
            write_buffers(folder / "exr" / name, judge.views, buffers)

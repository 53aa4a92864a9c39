"""What a refinement leaves behind: scores, checks, files."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from genmf_mi import bridge, memory
from genmf_mi.evaluate import Judge, unseen

if TYPE_CHECKING:
    from torch import Tensor

    from genmf_mi.refine import Result, _Job
    from genmf_mi.run import Run


def scores(job: _Job, shapes: dict[str, Tensor]) -> dict:
    """Scores of named shapes ``[V,3]`` on the standard views and, under ``unseen``, on the unseen ones."""
    piece, table = job.piece, {}
    judges = {"": job.judge}
    if not piece.reference.pictures:
        judges["unseen"] = Judge(piece.judged_reference, piece.judged_part, unseen(job.judge.views), job.judge.networks)
    for group, judge in judges.items():
        job.listener.say(f"scoring{', unseen views' if group else ''}")
        rows = judge.scores({name: judge.render(vertices) for name, vertices in shapes.items()})
        table |= {group: rows} if group else rows
    return table


def conclude(
    job: _Job,
    run: Run | None,
    offsets: np.ndarray,
    tangles: dict,
    seconds: dict,
    started: float,
    interrupted: bool,
    save_exr: bool,
) -> Result:
    """Score, check and, where there is a run folder, write everything."""
    import torch

    from genmf_mi import fabricate
    from genmf_mi.refine import Result

    piece, say = job.piece, job.listener.say
    refined = piece.vertices + offsets
    points = {"before": piece.vertices, "displacement": piece.vertices + job.displaced[:, None] * piece.normals}
    if job.without_stress is not None:
        points["unconstrained"] = piece.vertices + job.without_stress
    points["after"] = refined
    shapes = {name: torch.as_tensor(p, dtype=torch.float32, device=job.device) for name, p in points.items()}
    relief_mm = np.einsum("vk,vk->v", offsets, piece.normals) * piece.frame.mm_per_unit

    table = scores(job, shapes)
    seconds["evaluate"] = job.lap()

    say("checking the part")
    distance = np.linalg.norm(offsets, axis=1) * piece.frame.mm_per_unit
    part_mm = piece.frame.to_print(refined)
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
        "solid": {**piece.report, **tangles, **fabricate.check(part_mm, piece.faces)},
        **({"stress": job.verdict} if job.verdict else {}),
        "iterations": len(job.history),
        "interrupted": interrupted,
    }
    result = Result(
        vertices_mm=part_mm,
        vertices=piece.frame.restore(refined),
        faces=piece.faces,
        rgb=piece.rgb,
        relief_mm=relief_mm,
        metrics=metrics,
        history=job.history,
        out=run.folder if run else None,
    )
    if run:
        say("writing the files")
        metrics["files"] = fabricate.write(run.folder, refined, piece.faces, piece.frame, piece.rgb, piece.asset.name)
        write_pictures(job, run.folder, shapes, relief_mm, metrics, save_exr)
    seconds["write"] = job.lap()
    metrics["seconds"] = {"total": time.perf_counter() - started, **seconds}
    metrics["peak_memory_gb"] = memory.peak_gb()
    if run:
        run.finish(metrics)
    return result


def write_pictures(
    job: _Job, folder: Path, shapes: dict[str, Tensor], relief_mm: np.ndarray, metrics: dict, save_exr: bool
) -> None:
    """``before_after.png``, ``report.html`` and, on request, the buffers of every shape and view as OpenEXR."""
    from genmf_mi.report import Report, View, write_before_after, write_report

    piece, judge = job.piece, job.judge
    shown = {name: judge.look(vertices) for name, vertices in shapes.items()}
    grey, mask = (
        {name: getattr(b, channel)[:, 0].cpu().numpy() for name, b in shown.items()} for channel in ("grey", "coverage")
    )
    # The scene still holds the refined shape, which was rendered last
    relief = bridge.picture_of(judge.scene, judge.views, piece.faces, relief_mm)
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
            vertices=shapes["after"].cpu().numpy(),
            faces=piece.faces,
            colours=piece.rgb,
            relief_mm=relief_mm,
            cap_mm=job.config.max_relief_mm,
            size_mm=job.config.size_mm,
            material=judge.scene.material,
            steps=piece.report,
            original=piece.vertices,
        ),
    )
    if save_exr:
        from genmf_mi.exr import write_buffers

        for name, buffers in shown.items():
            write_buffers(folder / "exr" / name, judge.views, buffers)

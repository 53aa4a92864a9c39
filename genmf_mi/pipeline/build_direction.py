"""Which way up a part is printed.

Layers show on walls and hide on slopes, and what hangs over wants supports, so that both the look and the soundness of
a print depend on the build direction. The object is looked at as it stands on a shelf all the same.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch

from genmf_mi.core.frame import Up
from genmf_mi.core.printer import Printer
from genmf_mi.losses.alignment import Alignment
from genmf_mi.mesh.measures import face_areas
from genmf_mi.pipeline.evaluator import Evaluator
from genmf_mi.pipeline.poses import candidates
from genmf_mi.pipeline.problem import RefinementProblem
from genmf_mi.printing.printability import overhang_mm2

SUPPORT_PRICE = 1.0
"""Of supports under all of the surface, in units of the LPIPS of the untouched part."""


@dataclass(frozen=True)
class Candidate:
    """A way of standing, and what speaks for it.

    name: of :data:`genmf_mi.core.frame.DIRECTIONS`, or ``tilted``.
    lpips: of the displacement by brightness, predicted as printed; None without layers that can be seen.
    overhang_share: of the surface. height_mm: of the part on the bed.
    cost: what decides, see :func:`choose`; None where the bed of the printer is too small.
    """

    up: Up
    name: str
    lpips: float | None
    overhang_share: float
    height_mm: float
    cost: float | None


def choose(problem: RefinementProblem, evaluator: Evaluator, heights: np.ndarray, printer: Printer) -> list[Candidate]:
    """The ways in which the part may stand while it is printed, the best one first.

    The cost is LPIPS in the shading of layers, over that of the untouched part as it stands, plus the share of the
    surface that hangs over times :data:`SUPPORT_PRICE`. Without layers only the supports count.

    heights: ``[V]`` along the normals, of the displacement that is looked at.
    """
    surface = problem.surface
    total = float(face_areas(surface.vertices, surface.faces).sum()) * problem.frame.mm_per_unit**2
    found: list[Candidate] = []
    unit = 0.0
    for name, up in candidates(surface.vertices):
        part_mm = problem.frame.standing(up).to_print(surface.vertices)
        width, depth, height = (float(k) for k in np.ptp(part_mm, axis=0))
        share = overhang_mm2(part_mm, surface.faces, printer.layer_mm) / total
        lpips = None
        if printer.layered:
            before, lpips = _predicted(problem, evaluator, heights, up)
            unit = unit or before
        cost = SUPPORT_PRICE * share + (lpips / unit if lpips is not None else 0.0)
        found.append(Candidate(up, name, lpips, share, height, cost if printer.fits((width, depth, height)) else None))
    return sorted(found, key=lambda candidate: np.inf if candidate.cost is None else candidate.cost)


@torch.no_grad()
def _predicted(problem: RefinementProblem, evaluator: Evaluator, heights: np.ndarray, up: Up) -> tuple[float, float]:
    """LPIPS of the untouched part and of the displaced one in the shading of layers across ``up``."""
    surface, part = problem.surface, problem.evaluation.part
    stood = part.up
    part.stand(up)
    look = replace(evaluator)  # the object that it compares with stands as the part does
    shapes = surface.vertices, surface.vertices + heights[:, None] * surface.normals
    before, after = (look.render(torch.as_tensor(v, dtype=torch.float32, device=look.device)) for v in shapes)
    alignment = Alignment.fit(before.grey, before.geometry[2], look.target_grey, look.scorer.compared)
    images = {name: look.align(shown, alignment) for name, shown in (("before", before), ("after", after))}
    table = look.scorer.lpips(images, "alex")
    part.stand(stood)
    return table["before"][0], table["after"][0]

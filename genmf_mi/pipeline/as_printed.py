"""The verdict on what comes off the printer, instead of on the smooth surface: slice, extrude, look, score.

The beads that the slicer lays are modelled one by one and rendered so finely that layers are resolved, then averaged to
what is seen from afar: at 384² a pixel is 0.3 mm of a part of 100 mm, one minute of arc from a metre away. What is
compared with is the paint on the *printed* untouched part, what a printer with coloured filament would make; an object
without texture stays its own target.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from genmf_mi.core.frame import Frame
from genmf_mi.core.printer import Printer
from genmf_mi.core.progress import Progress
from genmf_mi.losses.alignment import Alignment
from genmf_mi.losses.lpips_weights import Network
from genmf_mi.pipeline.evaluator import RESOLUTION, SEED
from genmf_mi.pipeline.problem import RefinementProblem
from genmf_mi.pipeline.scoring import Scorer
from genmf_mi.printing.printed import Printed, print_part
from genmf_mi.render import bridge, lamps
from genmf_mi.render import scene as scenes
from genmf_mi.render.scene import RenderSettings
from genmf_mi.render.view import View

FINE, SAMPLES = 4, 9
"""Pixels across one of the pictures that are compared, and rays for each of them, under the two lights."""
FINE_LAMPS, SAMPLES_LAMPS = 2, 25
"""Likewise under the lamps."""
BLUR = 0.6
"""Standard deviation in pixels of the eye's point spread, which keeps layers from beating with pixels."""
SPILL = 9
"""Pixels around a pixel over which paint is spread to where beads reach beyond the outline of the smooth part."""
TWO_LIGHTS, LAMPS, PAINTED = "two_lights", "lamps", "_painted"
"""Lights without shadows, as in the loss, and with; and what is behind the name for pictures of the painted print."""


@dataclass(frozen=True)
class Pictures:
    """Linear grey values ``[B,1,H,W]``, weighted by the coverage ``[B,1,H,W]``."""

    grey: Tensor
    coverage: Tensor

    def of(self, views: slice) -> Pictures:
        """Those of some views."""
        return Pictures(self.grey[views], self.coverage[views])


@dataclass(frozen=True)
class PrintedViews:
    """A printed part, and pictures of it from the standard views by lighting: :data:`TWO_LIGHTS`, :data:`LAMPS`."""

    printed: Printed
    pictures: dict[str, Pictures]


class PrintGate:
    """Prints parts of one object, and takes their pictures.

    Args:
        frame: of the object. radius: of its bounding sphere, normalised units.
        program: of the slicer, None for our own.
        xml: scene file. folder: for STL, G-code and PLY files.
    """

    def __init__(
        self,
        frame: Frame,
        radius: float,
        printer: Printer,
        program: Path | None,
        xml: Path,
        folder: Path,
        progress: Progress | None = None,
    ) -> None:
        self._frame, self._printer, self._program = frame, printer, program
        self._settings = RenderSettings(radius, FINE * RESOLUTION, SAMPLES)
        self._xml, self._folder, self._progress = xml, folder, progress or Progress()

    def look(self, name: str, vertices: np.ndarray, faces: np.ndarray, paint: Tensor | None = None) -> PrintedViews:
        """Print a part, ``[V,3]`` in the normalised frame, and take its pictures from the standard views.

        paint: of :func:`paint_of`; with it there are also pictures of the painted print, :data:`PAINTED`.

        Raises:
            GenmfError: see :func:`genmf_mi.printing.printed.print_part`.
        """
        self._progress.stage(f"slicing: {name}")
        part = self._frame.to_print(vertices)
        printed = print_part(part, faces, self._printer, self._program, self._folder, name)
        self._progress.stage(f"looking at it as printed: {name}")
        ply, triangles = self._folder / f"{name}.ply", printed.triangles
        seen = self._frame.from_print(triangles.vertices, float((vertices @ np.array(self._frame.up)).min()))
        normals = self._frame.turned_from_print(triangles.normals)
        bridge.write_ply(ply, seen, triangles.faces, normals=normals)
        try:
            return PrintedViews(printed, self._pictures(ply, paint))
        finally:
            ply.unlink(missing_ok=True)

    def _pictures(self, ply: Path, paint: Tensor | None) -> dict[str, Pictures]:
        """One light after the other: each has a tree of millions of triangles of its own."""
        pictures, views, lighting = self._in_even_light(ply, paint)
        return {**pictures, **self._under_lamps(ply, paint, views, lighting, pictures[TWO_LIGHTS].coverage)}

    @torch.no_grad()
    def _in_even_light(
        self, ply: Path, paint: Tensor | None
    ) -> tuple[dict[str, Pictures], tuple[View, ...], lamps.Lighting]:
        scene = scenes.load(self._xml, ply, **asdict(self._settings))
        grey: dict[str, list[Tensor]] = {}
        coverages: list[Tensor] = []
        for i, view in enumerate(scene.views):
            fine = bridge.render(scene, [view], seed=SEED)
            coverages.append(far(fine.geometry[2], FINE))
            grey.setdefault(TWO_LIGHTS, []).append(far(fine.grey, FINE))
            if paint is not None:
                grey.setdefault(TWO_LIGHTS + PAINTED, []).append(far(fine.grey * paint[i : i + 1], FINE))
            self._progress.advance(i + 1, 2 * len(scene.views))
        coverage = torch.cat(coverages)
        pictures = {name: Pictures(torch.cat(images), coverage) for name, images in grey.items()}
        return pictures, scene.views, lamps.Lighting.of(scene)

    @torch.no_grad()
    def _under_lamps(
        self, ply: Path, paint: Tensor | None, views: tuple[View, ...], lighting: lamps.Lighting, coverage: Tensor
    ) -> dict[str, Pictures]:
        studio = lamps.Studio(lighting, ply, FINE_LAMPS * RESOLUTION, SAMPLES_LAMPS)
        grey: dict[str, list[Tensor]] = {}
        for i, view in enumerate(views):
            lit = studio.render(view, seed=SEED)
            grey.setdefault(LAMPS, []).append(far(lit, FINE_LAMPS))
            if paint is not None:
                coarse = F.avg_pool2d(paint[i : i + 1], FINE // FINE_LAMPS)
                grey.setdefault(LAMPS + PAINTED, []).append(far(lit * coarse, FINE_LAMPS))
            self._progress.advance(len(views) + i + 1, 2 * len(views))
        return {name: Pictures(torch.cat(images), coverage) for name, images in grey.items()}


@torch.no_grad()
def paint_of(problem: RefinementProblem) -> Tensor:
    """``[B,1,H,W]``: by how much the texture darkens the material in each of the standard views, at the fine
    resolution, and a little beyond the outline, where beads may reach."""
    pair, surface = problem.evaluation, problem.surface
    held = pair.reference.scene, pair.part
    before = [scene.resolution for scene in held]
    vertices, faces = torch.as_tensor(surface.vertices, dtype=torch.float32), torch.as_tensor(surface.faces)
    paints: list[Tensor] = []
    for scene in held:
        scene.resize(FINE * RESOLUTION)
    for view in pair.reference.views:
        textured = pair.reference.render([view], seed=SEED, samples=4)
        plain = bridge.render(pair.part, [view], vertices, faces, seed=SEED, samples=4)
        inside = plain.geometry[2]
        ratio = textured.grey / plain.grey.clamp_min(1e-4) * inside
        spread, weight = (F.avg_pool2d(x, SPILL, 1, SPILL // 2) for x in (ratio, inside))
        around = torch.where(weight > 1e-3, spread / weight.clamp_min(1e-3), torch.ones_like(weight))
        paints.append(torch.where(inside > 0.99, ratio, around))
    for scene, resolution in zip(held, before, strict=True):
        scene.resize(resolution)
    return torch.cat(paints)


def scores(
    parts: Mapping[str, PrintedViews],
    networks: tuple[Network, ...] = ("alex",),
    view: int | None = None,
    wanted: Tensor | None = None,
) -> dict[str, Any]:
    """:meth:`Scorer.verdicts` of printed parts by lighting; ``before`` has been looked at as the target.

    view: the only one to score; all of them if None. wanted: ``[B,1,H,W]``, see :class:`Scorer`.
    """
    chosen = slice(None) if view is None else slice(view, view + 1)
    table: dict[str, Any] = {}
    for light in (TWO_LIGHTS, LAMPS):
        painted, plain = (parts["before"].pictures[key].of(chosen) for key in (light + PAINTED, light))
        scorer = Scorer(painted.grey, painted.coverage, networks, None if wanted is None else wanted[chosen])
        alignment = Alignment.fit(plain.grey, plain.coverage, painted.grey, scorer.compared)
        shown = {name: part.pictures[light].of(chosen) for name, part in parts.items()}
        table[light] = scorer.verdicts(shown, alignment)
    return table


def far(image: Tensor, times: int) -> Tensor:
    """``[B,1,H,W]`` of ``times`` the resolution as it is seen from afar: blurred, then averaged over pixels."""
    deviation = BLUR * times
    reach = int(3 * deviation + 0.5)
    x = torch.arange(-reach, reach + 1, dtype=image.dtype, device=image.device)
    kernel = torch.exp(-0.5 * (x / deviation).square())
    kernel /= kernel.sum()
    image = F.conv2d(image, kernel.view(1, 1, -1, 1), padding=(reach, 0))
    image = F.conv2d(image, kernel.view(1, 1, 1, -1), padding=(0, reach))
    return F.avg_pool2d(image, times)

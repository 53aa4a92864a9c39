"""Score any one-colour shape against a textured asset: ``genmf-mi evaluate ORIGINAL REFINED``."""

from __future__ import annotations

import tempfile
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from genmf_mi.assets import samples
from genmf_mi.assets.asset import Asset, load
from genmf_mi.core.config import RefineConfig
from genmf_mi.core.frame import Frame
from genmf_mi.losses import lpips_conversion
from genmf_mi.losses.lpips_weights import Network
from genmf_mi.mesh import topology
from genmf_mi.pipeline import evaluator
from genmf_mi.pipeline.evaluator import unseen_views
from genmf_mi.pipeline.problem import build_problem
from genmf_mi.render import bridge, scene_file, variant
from genmf_mi.render import scene as scenes
from genmf_mi.render.scene import RenderSettings

WELD = 1e-6
"""Vertices closer than this share of the longest side are one: STL and textured files split theirs, which would show
every facet."""


def evaluate(
    original: str | Path | Asset,
    refined: str | Path | Asset,
    *,
    size_mm: float = 100.0,
    scene: str | Path | None = None,
    networks: tuple[Network, ...] = ("alex",),
    files_anywhere: bool = False,
    normal_map: bool = RefineConfig.normal_map,
    occlusion_map: bool = RefineConfig.occlusion_map,
    emissive_map: bool = RefineConfig.emissive_map,
) -> dict[str, Any]:
    """Score a one-colour shape against a textured asset.

    Args:
        original, refined: files, bundled samples or loaded assets in the same pose. Each is fitted into the frame by
            its own bounding box; print files, which are z up, are turned upright by their format.
        size_mm: longest side of the part.
        scene: scene file; the sample's own or ``default.xml`` if None.
        networks: LPIPS networks to score with.
        files_anywhere: let the files name others outside of their own folders, see :func:`genmf_mi.load`.
        normal_map, occlusion_map, emissive_map: what counts as the look of the asset, as in :class:`RefineConfig`.

    Returns:
        ``asset``; ``before``, ``after`` and ``paper_alignment`` as in :meth:`Evaluator.verdicts`; and the same under
        ``unseen``.

    Raises:
        GenmfError: as :func:`genmf_mi.refine`.
    """
    variant.use("auto")
    lpips_conversion.ensure(*networks)
    textured, shape = (
        a if isinstance(a, Asset) else load(samples.resolve(a), files_anywhere=files_anywhere)
        for a in (original, refined)
    )
    xml = Path(scene) if scene else scene_file.find(textured.name)
    config = RefineConfig(
        size_mm=size_mm, normal_map=normal_map, occlusion_map=occlusion_map, emissive_map=emissive_map
    )
    with tempfile.TemporaryDirectory(prefix="genmf-") as folder:
        problem = build_problem(textured, config, xml, Path(folder))
        longest = np.ptp(shape.vertices, axis=0).max()
        vertices, faces = topology.weld(shape.vertices, shape.faces, WELD * longest)
        vertices = Frame.of(vertices, size_mm).normalise(vertices)
        ply = Path(folder) / "refined.ply"
        bridge.write_ply(ply, vertices, faces)
        radius = float(np.linalg.norm(problem.surface.vertices, axis=1).max())
        settings = RenderSettings(radius, evaluator.RESOLUTION, evaluator.SAMPLES)
        after = scenes.load(xml, ply, **asdict(settings))
        metrics: dict[str, Any] = {"asset": textured.name, "unseen": {}}
        pair = problem.evaluation
        standard = evaluator.build_evaluator(pair.reference, pair.part, networks)
        unseen = replace(standard, views=unseen_views(standard.views))
        for group, score in ((metrics, standard), (metrics["unseen"], unseen)):
            parts: dict[str, bridge.Buffers] = {}
            for name, shown, points in (("before", pair.part, problem.surface.vertices), ("after", after, vertices)):
                score.scene = shown
                parts[name] = score.render(torch.as_tensor(points, dtype=torch.float32, device=score.device))
            group |= score.verdicts(parts)
    return metrics

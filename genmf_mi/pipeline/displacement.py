"""The baseline: offset the surface by brightness, as texture-to-relief tools do.

Both signs and several amplitudes are tried, and the one with the lowest LPIPS wins. It is scored beside the
refinement in every report, and the refinement starts from it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from genmf_mi.geometry.low_pass import low_frequency
from genmf_mi.pipeline.evaluation import Evaluator
from genmf_mi.pipeline.problem import BROAD_MM, RefinementProblem

AMPLITUDES = (-1.0, -0.5, -0.25, 0.25, 0.5, 1.0)
"""Shares of the cap; positive raises what is bright."""
LEAST_CONTRAST = 0.01
"""Of the encoded albedo; below it the object has one brightness."""


def heights(piece: RefinementProblem, amplitude: float) -> np.ndarray:
    """``[V]`` normalised units: brightness about its median, its 1st to 99th percentile spanning twice ``amplitude``
    times the room, cut off at the room. An object of one brightness stays as it is."""
    low, high = np.percentile(piece.brightness, [1, 99])
    if high - low < LEAST_CONTRAST:
        return np.zeros(len(piece.vertices))
    brightness = np.clip((piece.brightness - low) / (high - low), 0, 1)
    share = np.clip(2 * amplitude * (brightness - np.median(brightness)), -1, 1)
    return np.where(share > 0, share * piece.outward, share * piece.inward)


def start(piece: RefinementProblem, displaced: np.ndarray) -> np.ndarray:
    """The displacement without its broad part: ``[V]`` heights to start an optimisation from.

    Shading sees slopes, not heights. A plateau costs the room that its rim needs and shows nothing: what is broader
    than about ``BROAD_MM`` is taken out (see :func:`low_frequency`).
    """
    length = BROAD_MM / piece.frame.mm_per_unit
    return displaced - low_frequency(piece.vertices, piece.faces, displaced, length)


def best(
    piece: RefinementProblem, judge: Evaluator, say: Callable[[str], None] = lambda text: None
) -> tuple[np.ndarray, float]:
    """The heights ``[V]`` with the lowest LPIPS (AlexNet) over the judge's views, and their amplitude."""
    import torch

    say("displacing by brightness")
    images = {}
    for amplitude in AMPLITUDES:
        moved = piece.vertices + heights(piece, amplitude)[:, None] * piece.normals
        images[amplitude] = judge.render(torch.as_tensor(moved, dtype=torch.float32, device=judge.target.device))
    with torch.no_grad():
        scores = {amplitude: frame for amplitude, (frame, _) in judge.lpips(images, "alex").items()}
    winner = min(scores, key=scores.get)
    return heights(piece, winner), winner

"""Which alignment ranks parts as a person does: a ladder of hand-made parts, from flat to over-deep, right and bent."""

from __future__ import annotations

import numpy as np

import genmf_mi
from benchmarks import record
from benchmarks.inputs import Inputs
from genmf_mi.assets.asset import Asset

RADIUS_MM, DEPTH_MM, SPOT_MM = 50.0, 0.6, 9.0
"""A ball of 100 mm with twenty dark spots, each in a groove."""
PARTS = {"untouched": (0.0, 0.0), "flattened": (0.3, 0.0), "right": (1.0, 0.0), "over-deep": (4.0, 0.0),
         "right but bent": (1.0, 0.8)}  # fmt: skip
"""Depth of the grooves over that of the right part, and how far its plain areas are bent, in mm."""


def main(inputs: Inputs) -> None:
    """Score the parts of the ladder with one exposure and as the paper aligns.

    Args:
        inputs: What all benchmarks have in common; this one needs none of them.
    """
    import trimesh

    ball = trimesh.creation.icosphere(7)
    directions, faces = np.array(ball.vertices), np.array(ball.faces)
    centres = np.array(trimesh.creation.icosphere(0).vertices)
    away = RADIUS_MM * np.arccos(np.clip(directions @ centres.T, -1, 1)).min(axis=1)
    dark = np.float32(away < SPOT_MM)
    painted = Asset.from_arrays(
        "ladder", directions * RADIUS_MM, faces, colours=np.repeat(0.8 - 0.7 * dark[:, None], 3, 1)
    )
    groove = -np.exp(-0.5 * ((away - SPOT_MM) / 0.7) ** 2)
    bend = np.sin(directions[:, 1] * RADIUS_MM / 5) * np.clip((away - SPOT_MM - 3) / 3, 0, 1)
    rows = {}
    for name, (depth, bent) in PARTS.items():
        height = depth * DEPTH_MM * groove + bent * bend
        part = Asset.from_arrays(name, directions * (RADIUS_MM + height)[:, None], faces)
        scores = genmf_mi.evaluate(painted, part)
        rows[name] = {
            key: {"room": round(scores["after"][key], 4), "paper": round(scores["paper_alignment"]["after"][key], 4)}
            for key in ("lpips_alex", "ssim", "g_ssim")
        }
        print(name, rows[name], flush=True)
    record.write("alignment_ladder", {"parts": rows})

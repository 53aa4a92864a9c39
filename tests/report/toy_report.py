"""A small report: a sphere with two views, forty iterations and a few metrics."""

from __future__ import annotations

import numpy as np

from genmf_mi.report import Report, View

METRICS = {
    "before": {"ssim": 0.7988, "lpips_alex": 0.2257, "g_ssim": 0.7801},
    "displacement": {"ssim": 0.7920, "lpips_alex": 0.1856, "g_ssim": 0.7846},
    "after": {"ssim": 0.8253, "lpips_alex": 0.1418, "g_ssim": 0.7701},
    "unseen": {"before": {"lpips_alex": 0.2010}, "after": {"lpips_alex": 0.1344}},
    "relief_mm": {"max": 0.93, "p99": 0.71, "mean": 0.2},
    "solid": {"watertight": True, "bodies": 1, "self_intersections": 0, "volume_mm3": 81234.5},
    "seconds": {"total": 142.3},
    "iterations": 40,
}

MATERIAL = {
    "albedo": 0.7, "ambient": 0.1, "key": [0.0, 0.0, 1.0], "fill": [1.0, 0.0, 0.0], "key_weight": 0.6,
    "fill_weight": 0.3, "sharpness": 5.0, "lights": "camera"}  # fmt: skip


def sphere(rows: int = 40, columns: int = 60) -> tuple[np.ndarray, np.ndarray]:
    """A closed sphere of radius 0.95 with the poles as single vertices."""
    polar, turn = np.linspace(0, np.pi, rows + 2)[1:-1], np.arange(columns) * 2 * np.pi / columns
    p, t = (grid.ravel() for grid in np.meshgrid(polar, turn, indexing="ij"))
    ring = np.stack([np.sin(p) * np.sin(t), np.cos(p), np.sin(p) * np.cos(t)], axis=1)
    vertices = np.concatenate([ring, [[0, 1, 0], [0, -1, 0]]]) * 0.95
    i, j = (grid.ravel() for grid in np.meshgrid(np.arange(rows - 1), np.arange(columns), indexing="ij"))
    k = (j + 1) % columns
    a, b, c, d = i * columns + j, (i + 1) * columns + j, (i + 1) * columns + k, i * columns + k
    first, last = np.arange(columns), (rows - 1) * columns + np.arange(columns)
    north, south = np.full(columns, len(ring)), np.full(columns, len(ring) + 1)
    faces = np.concatenate(
        [
            np.stack([a, b, c], 1),
            np.stack([a, c, d], 1),
            np.stack([north, first, np.roll(first, -1)], 1),
            np.stack([south, np.roll(last, -1), last], 1),
        ]
    )
    return vertices.astype(np.float32), faces


def view(label: str, side: int = 64, change: float = 0.1, wide: float = 1.0) -> View:
    """A disc (or an ellipse) lit from above, with a soft edge; the refinement darkens its left half by ``change``."""
    y, x = np.mgrid[0:side, 0:side] / (side - 1) * 2 - 1
    mask = np.clip((0.8 - np.hypot(x / min(wide, 1), y * max(wide, 1))) * side / 2, 0, 1).astype(np.float32)
    before = (0.6 - 0.2 * y).astype(np.float32) * mask
    after = before - np.where(x < 0, change, 0).astype(np.float32) * mask
    colour = np.stack([before, before * 0.5, before * 0.2], axis=2)
    relief = np.where(mask > 0, np.where(x < 0, -0.5, 0.5), np.nan).astype(np.float32)
    return View(label, mask, colour, before, before, before, after, relief)


def toy_report() -> Report:
    vertices, faces = sphere()
    relief = np.where(vertices[:, 0] > 0.3, 0.8, -0.2)
    refined = vertices * (1 + relief[:, None] / 50 / 0.95)
    history = [
        {
            "iteration": i,
            "stage": 1 if i < 25 else 2,
            "loss": 2.0 - 0.04 * i,
            "lpips": 1.0 - 0.02 * i,
            "seconds": 0.3 * i,
        }
        for i in range(40)
    ]
    return Report(
        title="ladybird",
        views=[view("azimuth 0°, elevation 20°"), view("azimuth 60°, elevation 20°", change=0.3)],
        history=history,
        metrics=METRICS,
        config={"size_mm": 100.0, "nozzle_mm": 0.4, "loss": {"weight": 0.5}},
        vertices=refined.astype(np.float32),
        original=vertices,
        faces=faces,
        colours=np.clip(np.abs(vertices), 0, 1).astype(np.float32),
        relief_mm=relief,
        cap_mm=1.0,
        size_mm=100.0,
        material=MATERIAL,
        steps={"log": ["welded 12 vertices", "closed 1 hole"], "faces": len(faces)},
    )

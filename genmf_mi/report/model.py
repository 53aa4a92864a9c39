"""What the pictures and the report are made from."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from PIL.Image import Image


@dataclass(frozen=True)
class View:
    """One standard view of the object.

    Images are float32, linear, 0..1, and premultiplied by ``mask``: averages over the samples of a pixel, 0 where no
    sample hits the object, as the integrator leaves them.

    label: what the view is, for people, e.g. "azimuth 60°, elevation 20°".
    mask: ``[H,W]``, coverage.
    colour: ``[H,W,3]``, the textured object under the lights, linear RGB.
    reference: ``[H,W]``, grey value of the textured object (G_gt).
    before: ``[H,W]``, the original shape in one colour.
    displacement: ``[H,W]``, the luminance displacement in one colour, or None where it was not made.
    after: ``[H,W]``, the refined shape in one colour.
    relief_mm: ``[H,W]``, signed relief in mm, positive where raised, NaN outside of the object.
    displacement_mask, after_mask: ``[H,W]``, coverage of those two shapes, whose silhouettes differ a little from the
        original's. Without them it is ``mask`` wherever the image is not black, which leaves hard edges.
    """

    label: str
    mask: np.ndarray
    colour: np.ndarray
    reference: np.ndarray
    before: np.ndarray
    displacement: np.ndarray | None
    after: np.ndarray
    relief_mm: np.ndarray
    displacement_mask: np.ndarray | None = None
    after_mask: np.ndarray | None = None

    def coverage(self, kind: str) -> np.ndarray:
        """Coverage ``[H,W]`` of the image called ``kind``."""
        if kind not in ("displacement", "after"):
            return self.mask
        mask = getattr(self, f"{kind}_mask")
        return self.mask * (getattr(self, kind) > 0) if mask is None else mask


@dataclass(frozen=True)
class Report:
    """One run.

    title: name of the object, free text.
    views: the standard views, at least one.
    history: one dict per iteration with ``iteration``, ``stage``, ``loss``, ``seconds`` and each loss term by its name.
    metrics: nested as in ``metrics.json``; missing values may be absent, None or NaN.
    config: the settings, possibly nested.
    vertices: ``[V,3]``, the refined shape in the normalised frame, y up.
    faces: ``[F,3]``, indices into ``vertices``.
    colours: ``[V,3]``, linear RGB, 0..1.
    relief_mm: ``[V]``, signed relief in mm.
    cap_mm: the largest relief allowed, and the range of the relief colours.
    size_mm: longest side of the printed object.
    material: parameters of ``twolight`` that the views were rendered with,
        :attr:`genmf_mi.render.scene.Scene.material`.
    steps: what was done to the mesh before refining, as the ``solid`` block of the metrics reports it.
    original: ``[V,3]``, the shape before refining with the same ``faces``; without it the 3D view cannot compare.
    as_printed, as_printed_names: rows of pictures of the printed parts by lighting, and what each column shows.
    regions: pictures of what was painted on the part, by view; empty where nothing was.
    """

    title: str
    views: list[View]
    history: list[dict]
    metrics: dict
    config: dict
    vertices: np.ndarray
    faces: np.ndarray
    colours: np.ndarray
    relief_mm: np.ndarray
    cap_mm: float
    size_mm: float
    material: dict
    steps: dict = field(default_factory=dict)
    original: np.ndarray | None = None
    as_printed: dict[str, list[Image]] = field(default_factory=dict)
    as_printed_names: list[str] = field(default_factory=list)
    regions: dict[str, Image] = field(default_factory=dict)

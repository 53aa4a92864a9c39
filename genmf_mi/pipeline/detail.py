"""What of the texture counts as detail, how strong it is, and where it calls for small triangles."""

from __future__ import annotations

import numpy as np

from genmf_mi.assets.asset import Asset
from genmf_mi.mesh.measures import face_areas, face_normals
from genmf_mi.pipeline.surface import seen_at, signals

DETAIL_MM = 8.0
"""Longest wavelength that counts as detail on the printed part; what is broader is shape or tone."""
FULL_CONTRAST = 0.11
"""Local contrast of the encoded brightness from which on the whole cap may be used."""
STRONG = 0.2
"""Local contrast that counts however small it is."""
FAINT, CRISP = 0.06, 0.2
"""Ranges of the encoded brightness over a few triangles below which there is no texture to speak of, and from which on
it has edges."""

SOFT = 0.1
"""Share of the textured area with crisp edges up to which a texture counts as soft."""


def local_contrast(detail: np.ndarray) -> float:
    """How much detail there is: the 99th percentile of | brightness − its low-frequency component |, ``detail [V]``.

    A soft blush or the speckle of a lemon has 0.05, painted porcelain 0.12, spots and windows 0.3 to 0.5. Relief in
    proportion keeps what is faint in colour faint in shape, which mean–variance alignment alone would amplify. Eyes are
    less than a hundredth of a figure: what is :data:`STRONG` counts from a thousandth on.
    """
    most, small = np.percentile(detail, [99, 99.9])
    return float(small if small >= STRONG else most)


def span(brightness: np.ndarray) -> tuple[float, float]:
    """The darkest and the brightest that count: of all but a hundredth at either end, or where that is one brightness
    as good as, of all but a thousandth, so that the eyes of a plain figure are found.

    brightness: ``[V]``, sRGB-encoded.
    """
    smallest, low, high, largest = (float(x) for x in np.percentile(brightness, [0.1, 1, 99, 99.9]))
    return (smallest, largest) if high - low < STRONG <= largest - smallest else (low, high)


def local_range(asset: Asset, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """``[F]``: the range of the encoded brightness over each face and its neighbours, 0 where it is :data:`FAINT`; of a
    normal map, that of the shading that it makes.

    It is looked up at the middles of faces and edges too: strokes are thinner than the triangles that they call for.

    vertices: ``[V,3]`` in the units of the file. faces: ``[F,3]``.
    """
    corners = vertices[faces]
    points = np.concatenate([corners, (corners + np.roll(corners, -1, axis=1)) / 2, corners.mean(axis=1)[:, None]], 1)
    normals = np.repeat(face_normals(vertices, faces), points.shape[1], axis=0)
    spacing = float(np.sqrt(face_areas(vertices, faces).mean()) / 2)
    seen = signals(*seen_at(asset, points.reshape(-1, 3), normals, spacing))
    contrast = np.zeros(len(faces))
    for signal in seen.reshape(*points.shape[:2], -1).transpose(2, 0, 1):
        low, high = np.full(len(vertices), np.inf), np.full(len(vertices), -np.inf)
        for corner in faces.T:
            np.minimum.at(low, corner, signal.min(axis=1))
            np.maximum.at(high, corner, signal.max(axis=1))
        contrast = np.maximum(contrast, high[faces].max(axis=1) - low[faces].min(axis=1))
    return np.where(contrast > FAINT, contrast, 0.0)


def crispness(vertices: np.ndarray, faces: np.ndarray, contrast: np.ndarray) -> float:
    """Share of the textured area that has crisp edges, 0 to 1, from :func:`local_range` ``[F]``.

    Letters and windows have 0.5 and more; the veins of a garlic, which are soft and everywhere, less than 0.05.
    """
    area = face_areas(vertices, faces)
    return float(area[contrast > CRISP].sum() / max(area[contrast > 0].sum(), 1e-30))

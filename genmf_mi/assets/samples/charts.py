"""Surfaces of rectangular charts, with a texture that is a function of the 3D point.

A sample is a few :class:`Chart` grids whose borders meet exactly, and a function ``paint(points, texel)`` that gives
the colour of any point in space. A texel's colour is that of the point on the mesh it lies on, so neighbouring charts
agree along their common border, and no pattern is stretched, pinched or torn by the layout of the texture.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from PIL import Image
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

GUTTER = 4
"""Texels between a chart and the edge of its box; they repeat the border's colour, so that filtering shows no seam."""

Field = Callable[[np.ndarray], np.ndarray]
"""Points ``[N,3]`` to values ``[N]``: negative inside, positive outside, about a distance near the surface."""

Paint = Callable[[np.ndarray, float], np.ndarray]
"""Points ``[N,3]`` and the size of a texel in the same unit to sRGB colours ``[N,3]`` in 0..1."""


@dataclass(frozen=True)
class Chart:
    """A grid of points and the part of the texture it owns.

    points: ``[rows, columns, 3]``; columns run along u and rows along v (up), their cross product points outwards.
    box: left, bottom, right, top of the part, as fractions of the texture with v up.
    """

    points: np.ndarray
    box: tuple[float, float, float, float]


def assemble(charts: Sequence[Chart], paint: Paint, resolution: int) -> trimesh.Trimesh:
    """The textured mesh of ``charts``, moved so that its bounding box is centred and its longest side is 1.

    Vertices are split where charts meet. The texture is ``resolution``² texels with all of them filled, in sRGB.
    """
    longest = max(np.ptp(np.concatenate([chart.points.reshape(-1, 3) for chart in charts]), axis=0))
    texel = 2.0 * longest / resolution
    texture = np.zeros((resolution, resolution, 3), np.uint8)
    vertices, faces, uv, offset = [], [], [], 0
    for chart in charts:
        rows, columns, _ = chart.points.shape
        left, bottom, right, top = np.rint(np.asarray(chart.box) * resolution).astype(int)
        u, along_u = _axis(left, right, columns)
        v, along_v = _axis(bottom, top, rows)
        surface = np.einsum("ir,rcx,jc->ijx", along_v, chart.points, along_u, optimize=True)
        colours = paint(surface.reshape(-1, 3), texel).reshape(surface.shape)
        # Row 0 of an image is at the top, v = 0 at the bottom.
        texture[resolution - top : resolution - bottom, left:right] = np.rint(255 * colours.clip(0, 1))[::-1]
        vertices.append(chart.points.reshape(-1, 3))
        uv.append(np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2) / resolution)
        faces.append(_triangles(chart.points) + offset)
        offset += rows * columns
    points = np.concatenate(vertices)
    points = (points - (points.min(axis=0) + points.max(axis=0)) / 2) / longest
    material = PBRMaterial(baseColorTexture=Image.fromarray(texture), metallicFactor=0.0, roughnessFactor=0.7)
    visual = TextureVisuals(uv=np.concatenate(uv), material=material)
    return trimesh.Trimesh(points, np.concatenate(faces), visual=visual, process=False)


def cube_sphere(
    field: Field, subdivisions: int = 56, stretch: tuple[float, float, float] = (1, 1, 1), reach: float = 2
) -> list[Chart]:
    """Six charts on the surface where ``field`` is zero, which every ray from the origin must cross once.

    The rays are those of a cube whose faces are cut into equal angles, multiplied by ``stretch``: give an elongated
    solid its own proportions and the triangles are even. ``reach`` is beyond the surface in every direction.
    """
    half = np.tan(np.linspace(0, np.pi / 4, subdivisions // 2 + 1))
    # Exactly symmetric, so that the borders of the charts agree in every bit.
    ticks = np.concatenate([-half[:0:-1], half])
    across, up = np.meshgrid(ticks, ticks)
    one = np.ones_like(across)
    sides = [  # outward axis, u axis, v axis: right-handed
        np.stack([across, up, one], axis=-1),
        np.stack([one, up, -across], axis=-1),
        np.stack([-across, up, -one], axis=-1),
        np.stack([-one, up, across], axis=-1),
        np.stack([across, one, -up], axis=-1),
        np.stack([across, -one, up], axis=-1),
    ]
    # Each point of a border is solved for once, whichever charts it belongs to.
    rays, where = np.unique(np.stack(sides).reshape(-1, 3), axis=0, return_inverse=True)
    points = cast(field, rays * stretch, reach)[where.reshape(-1)].reshape(6, *across.shape, 3)
    return [Chart(points[i], (i % 3 / 3, i // 3 / 2, (i % 3 + 1) / 3, (i // 3 + 1) / 2)) for i in range(6)]


def cast(field: Field, rays: np.ndarray, reach: float = 2) -> np.ndarray:
    """Where rays ``[N,3]`` from the origin leave the solid ``field``, by bisection: ``[N,3]``."""
    rays = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    inside, outside = np.zeros(len(rays)), np.full(len(rays), float(reach))
    for _ in range(32):
        middle = (inside + outside) / 2
        leaves = field(rays * middle[:, None]) > 0
        inside, outside = np.where(leaves, inside, middle), np.where(leaves, middle, outside)
    return rays * inside[:, None]


def _axis(start: int, stop: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Grid lines ``[count]`` of a box in texels, and interpolation weights ``[stop - start, count]`` of its texels."""
    # A border runs through the centres of texels: filtered there, two charts give the very same colour.
    lines = np.linspace(start + GUTTER + 0.5, stop - GUTTER - 0.5, count)
    centres = np.clip(np.arange(start, stop) + 0.5, lines[0], lines[-1])
    spacing = lines[1] - lines[0]
    return lines, np.clip(1 - np.abs(centres[:, None] - lines) / spacing, 0, 1)


def _triangles(points: np.ndarray) -> np.ndarray:
    """Faces ``[2(R-1)(C-1), 3]`` of a grid ``[R,C,3]``, each cell cut along its shorter diagonal."""
    index = np.arange(points.shape[0] * points.shape[1]).reshape(points.shape[:2])
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    rising = np.linalg.norm(points[:-1, :-1] - points[1:, 1:], axis=-1)
    falling = np.linalg.norm(points[:-1, 1:] - points[1:, :-1], axis=-1)
    from_a = rising < falling
    # A corner cell is cut from the corner: otherwise two charts back to back would share a whole triangle there.
    from_a[[0, -1], [0, -1]], from_a[[0, -1], [-1, 0]] = True, False
    first = np.where(from_a[..., None], np.stack([a, b, c], -1), np.stack([a, b, d], -1))
    second = np.where(from_a[..., None], np.stack([a, c, d], -1), np.stack([b, c, d], -1))
    return np.concatenate([first.reshape(-1, 3), second.reshape(-1, 3)])

"""What the sample with a given number is: its shape, pose and relief, all from the seed of the data set."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from genmf_mi.core.errors import SolidError
from genmf_mi.core.frame import HALF_EXTENT, Frame
from genmf_mi.sdf.distance import axis, signed_distance
from genmf_mi.stress.data.shapes import FAMILIES, Shape, relief, rotated
from genmf_mi.stress.fem import surface
from genmf_mi.stress.fem.simulation import frame_of

MESH_SHARE = 0.4
"""Share of the shapes that comes from the given files, where there are any."""
AMPLITUDE_MM, WAVELENGTH_MM = (0.3, 1.5), (2.0, 8.0)
SCALE = (0.75, 1.33)
"""Each axis is stretched by a factor between these, evenly in the logarithm."""
VOLUME_FRACTION = (0.004, 0.35)
"""Of the cube about a procedural shape, at least and at most; a fuller one takes a minute and more to solve."""
MAX_THIN_FRACTION, MAX_LOOSE_FRACTION = 0.4, 0.005
"""Largest share of the surface that may be thin, and of the volume that may be loose, in a sample."""
SPLIT = (("train", 0.8), ("validation", 0.9), ("test", 1.0))


@dataclass(frozen=True)
class Recipe:
    """One sample. Samples 2k and 2k+1 are one shape, without and with relief.

    shape: name of the shape, the same for all its variants. family: where it comes from. relief: (amplitude,
    wavelength) in mm, or None.
    """

    index: int
    shape: str
    family: str
    path: Path | None
    relief: tuple[float, float] | None

    @property
    def split(self) -> str:
        """Train, validation or test; it depends on the name of the shape alone, and so holds across data sets."""
        digest = int.from_bytes(hashlib.sha256(self.shape.encode()).digest()[:8], "big") / 2**64
        return next(name for name, bound in SPLIT if digest < bound)


def recipe_of(index: int, seed: int, sources: dict[str, Path], same: dict[str, str]) -> Recipe:
    """The recipe of sample ``index``.

    Args:
        sources: mesh files by name. same: names of files that are another file's shape, to the name of that one.
    """
    pair = index // 2
    rng = np.random.default_rng([seed, pair])
    if sources and rng.random() < MESH_SHARE:
        name = sorted(sources)[rng.integers(len(sources))]
        shape, family, path = same.get(name, name), "mesh", sources[name]
    else:
        family = sorted(FAMILIES)[rng.integers(len(FAMILIES))]
        shape, path = f"{family}-{seed}-{pair}", None
    bumps = None
    if index % 2:
        rng = np.random.default_rng([seed, pair, 1])
        bumps = (float(rng.uniform(*AMPLITUDE_MM)), float(rng.uniform(*WAVELENGTH_MM)))
    return Recipe(index, shape, family, path, bumps)


def surface_of(what: Recipe, seed: int, size_mm: float, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Vertices in the normalised frame and faces of the sample.

    Raises:
        SolidError: no acceptable shape came out. AssetError: the file cannot be read.
    """
    rng = np.random.default_rng([seed, what.index // 2, 2])
    smallest, largest = np.log(SCALE)
    angle, scale = rng.uniform(0, 2 * np.pi), np.exp(rng.uniform(smallest, largest, 3))
    if what.path is None:
        phi = _procedural(what.family, rng, angle, scale, n)
    else:
        vertices, faces = surface.load(what.path)
        c, s = np.cos(angle), np.sin(angle)
        vertices = (vertices * scale) @ np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
        vertices = frame_of(vertices, size_mm).normalise(vertices)
        if what.relief is None:
            return vertices, faces
        phi = signed_distance(vertices, faces, n)
    if what.relief is not None:
        units = 2 * HALF_EXTENT / size_mm
        amplitude, wavelength = (units * value for value in what.relief)
        bumps = relief(np.random.default_rng([seed, what.index // 2, 3]), amplitude, wavelength)
        near = np.abs(phi) < 1.5 * amplitude + 4.0 / (n - 1)
        phi[near] += bumps(_points(near))
    return contour(phi)


def check_thin(what: Recipe, thin: float) -> None:
    """Raises :class:`SolidError` for a shape that the grid cannot hold: see :func:`distance.thin_fraction`."""
    if thin > MAX_THIN_FRACTION:
        raise SolidError(f"{what.shape}: thinner than two grid cells under {thin:.0%} of its surface.")


def check_whole(what: Recipe, dropped: list[float], kept: float) -> None:
    """Raises :class:`SolidError` for a shape that comes apart when meshed: Φ would show more than the field."""
    if sum(dropped) > MAX_LOOSE_FRACTION * kept:
        raise SolidError(f"{what.shape}: {len(dropped)} parts hang together by less than a face.")


def _procedural(family: str, rng: np.random.Generator, angle: float, scale: np.ndarray, n: int) -> np.ndarray:
    """A field on the n³ grid whose zero surface is the shape, and which is about a distance near it."""
    for _ in range(12):
        shape = rotated(FAMILIES[family](rng), angle, scale)
        rough, half = 97, 2.2
        ticks = half * axis(rough)
        inside = _largest_component(_evaluate(shape, ticks, ticks, ticks)) < 0
        if not inside.any():
            continue
        indices = np.argwhere(inside)
        low, high = ticks[indices.min(axis=0)], ticks[indices.max(axis=0)]
        longest = (high - low).max()
        volume_fraction = inside.sum() * (ticks[1] - ticks[0]) ** 3 / longest**3
        if longest > 2 * half * 0.96 or not VOLUME_FRACTION[0] < volume_fraction < VOLUME_FRACTION[1]:
            continue
        centre, reach = (low + high) / 2, longest / 2 / 0.9
        return _refined(lambda p, s=shape, c=centre, r=reach: s(p * r + c) / r, n)
    raise SolidError(f"twelve random shapes of the family {family} were all too thin or too full.")


def _evaluate(shape: Shape, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    return shape(np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1))


def _refined(shape: Shape, n: int) -> np.ndarray:
    """``shape`` on the n³ grid; evaluated at every other sample, and at all of them near the surface."""
    from scipy.ndimage import zoom

    half = (n + 1) // 2
    ticks = axis(half)
    field = np.asarray(zoom(_evaluate(shape, ticks, ticks, ticks), n / half, order=1, grid_mode=False))
    near = np.abs(field) < 8.0 / (n - 1)
    field[near] = shape(_points(near))
    slope = np.sqrt(sum(g**2 for g in np.gradient(field, 2.0 / (n - 1))))
    return field / np.clip(slope, 0.5, 2.0)


def _points(chosen: np.ndarray) -> np.ndarray:
    """Positions ``[M,3]`` of the samples that are True in ``chosen [n,n,n]``."""
    ticks = axis(chosen.shape[0])
    return np.stack([ticks[i] for i in np.nonzero(chosen)], axis=-1)


def _largest_component(field: np.ndarray) -> np.ndarray:
    """The field without all but the largest component of its inside."""
    from scipy.ndimage import label

    component = np.empty(field.shape, dtype=np.int32)
    label(field < 0, output=component)
    if component.max() < 2:
        return field
    largest = np.bincount(component.reshape(-1))[1:].argmax() + 1
    return np.where((component > 0) & (component != largest), 1e-3, field)


def contour(field: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The zero surface of a field on [-1, 1]³, in the normalised frame."""
    from skimage.measure import marching_cubes

    field = _largest_component(field)
    if not field.min() < 0 < field.max():
        raise SolidError("nothing is left of the shape.")
    vertices, faces, _, _ = marching_cubes(field, 0.0)
    return Frame.of(vertices, 1.0).normalise(vertices.astype(np.float64)), faces.astype(np.int64)

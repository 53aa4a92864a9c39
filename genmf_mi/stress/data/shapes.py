"""Procedural shapes for training: seven families, each a random implicit function of a point, negative inside.

The functions are distances only roughly; Φ is measured afterwards on the surface that they give. y is up.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce

import numpy as np
from numpy.typing import ArrayLike

Shape = Callable[[np.ndarray], np.ndarray]
"""Maps points ``[...,3]`` in about [-1, 1]³ to values ``[...]``."""


def sphere(centre: ArrayLike, radius: float) -> Shape:
    return lambda p: np.linalg.norm(p - np.asarray(centre), axis=-1) - radius


def ellipsoid(centre: ArrayLike, radii: ArrayLike) -> Shape:
    radii = np.asarray(radii)
    return lambda p: (np.linalg.norm((p - np.asarray(centre)) / radii, axis=-1) - 1.0) * radii.min()


def box(centre: ArrayLike, half: ArrayLike, rounding: float = 0.0) -> Shape:
    half = np.asarray(half) - rounding

    def value(p: np.ndarray) -> np.ndarray:
        q = np.abs(p - np.asarray(centre)) - half
        return np.linalg.norm(np.maximum(q, 0.0), axis=-1) + np.minimum(q.max(axis=-1), 0.0) - rounding

    return value


def capsule(a: ArrayLike, b: ArrayLike, radius: float, radius_b: float | None = None) -> Shape:
    """From ``a`` to ``b``, the radius changing linearly."""
    a, b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    end = radius if radius_b is None else radius_b

    def value(p: np.ndarray) -> np.ndarray:
        t = np.clip((p - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
        return np.linalg.norm(p - a - t[..., None] * (b - a), axis=-1) - (radius + (end - radius) * t)

    return value


def cylinder(centre: ArrayLike, axis: int, radius: float, half_length: float) -> Shape:
    centre = np.asarray(centre, dtype=float)
    others = [i for i in range(3) if i != axis]

    def value(p: np.ndarray) -> np.ndarray:
        q = p - centre
        return np.maximum(np.linalg.norm(q[..., others], axis=-1) - radius, np.abs(q[..., axis]) - half_length)

    return value


def cone(centre: ArrayLike, radius: float, height: float) -> Shape:
    """Upright, base at ``centre``."""
    centre = np.asarray(centre, dtype=float)

    def value(p: np.ndarray) -> np.ndarray:
        q = p - centre
        slope = np.linalg.norm(q[..., [0, 2]], axis=-1) - radius * (1.0 - q[..., 1] / height)
        return np.maximum(slope * height / np.hypot(radius, height), np.maximum(-q[..., 1], q[..., 1] - height))

    return value


def torus(centre: ArrayLike, axis: int, major: float, minor: float) -> Shape:
    centre = np.asarray(centre, dtype=float)
    others = [i for i in range(3) if i != axis]

    def value(p: np.ndarray) -> np.ndarray:
        q = p - centre
        return np.hypot(np.linalg.norm(q[..., others], axis=-1) - major, q[..., axis]) - minor

    return value


def union(*shapes: Shape) -> Shape:
    return lambda p: reduce(np.minimum, (shape(p) for shape in shapes))


def intersection(*shapes: Shape) -> Shape:
    return lambda p: reduce(np.maximum, (shape(p) for shape in shapes))


def difference(shape: Shape, *holes: Shape) -> Shape:
    return lambda p: reduce(np.maximum, (-hole(p) for hole in holes), shape(p))


def smooth_union(shapes: list[Shape], width: float) -> Shape:
    """Polynomial smooth minimum (Quilez), rounded over about ``width``."""

    def pair(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        h = np.maximum(width - np.abs(a - b), 0.0) / width
        return np.minimum(a, b) - h * h * width / 4

    return lambda p: reduce(pair, (shape(p) for shape in shapes))


def rotated(shape: Shape, angle: float, scale: ArrayLike = (1.0, 1.0, 1.0)) -> Shape:
    """Rotated about the vertical by ``angle`` radians after scaling each axis."""
    c, s = np.cos(angle), np.sin(angle)
    back = np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]]) / np.asarray(scale)[:, None]
    smallest = np.min(scale)
    return lambda p: shape(p @ back.T) * smallest


def blobs(rng: np.random.Generator) -> Shape:
    centres = [rng.uniform(-0.5, 0.5, 3)]
    for _ in range(rng.integers(2, 8)):
        centres.append(centres[rng.integers(len(centres))] + rng.normal(size=3) * 0.28)
    parts = [ellipsoid(c, rng.uniform(0.14, 0.42) * rng.uniform(0.6, 1.4, 3)) for c in centres]
    return smooth_union(parts, rng.uniform(0.05, 0.3))


def _primitive(rng: np.random.Generator, reach: float, size: float) -> Shape:
    centre, radius = rng.uniform(-reach, reach, 3), size * rng.uniform(0.5, 1.0)
    return [
        lambda: sphere(centre, radius),
        lambda: rotated(box(centre, size * rng.uniform(0.4, 1.0, 3), rng.uniform(0.0, 0.05)), rng.uniform(0, np.pi)),
        lambda: cylinder(centre, int(rng.integers(3)), radius * 0.7, size),
        lambda: cone(centre - [0, size, 0], radius, 2 * size),
        lambda: torus(centre, int(rng.integers(3)), radius * 0.9, radius * 0.35),
    ][rng.integers(5)]()


def csg(rng: np.random.Generator) -> Shape:
    solid = union(*(_primitive(rng, 0.35, rng.uniform(0.35, 0.65)) for _ in range(rng.integers(2, 5))))
    return difference(solid, *(_primitive(rng, 0.5, rng.uniform(0.15, 0.4)) for _ in range(rng.integers(1, 4))))


def walls(rng: np.random.Generator) -> Shape:
    """Thin upright walls on a plate: a box without a lid, with partitions."""
    thickness = rng.uniform(0.075, 0.13)
    half = np.array([rng.uniform(0.5, 0.9), rng.uniform(0.25, 0.8), rng.uniform(0.4, 0.9)])
    parts = [box((0, -half[1] + thickness / 2, 0), (half[0], thickness / 2, half[2]))]
    for axis in (0, 2):
        places = [-1.0, 1.0] if rng.random() < 0.7 else [-1.0]
        places += list(rng.uniform(-0.7, 0.7, rng.integers(0, 3)))
        for place in places:
            wall, centre = half.copy(), np.zeros(3)
            wall[axis], centre[axis] = thickness / 2, place * (half[axis] - thickness / 2)
            parts.append(box(centre, wall))
    return union(*parts)


def bracket(rng: np.random.Generator) -> Shape:
    """An L, U or T profile with holes and a gusset."""
    thickness = rng.uniform(0.1, 0.24)
    length, height, depth = rng.uniform(0.6, 0.95), rng.uniform(0.4, 0.9), rng.uniform(0.25, 0.6)
    base = -height
    parts = [box((0, base + thickness / 2, 0), (length, thickness / 2, depth))]
    uprights = [[-length + thickness / 2], [-length + thickness / 2, length - thickness / 2], [0.0]][rng.integers(3)]
    parts += [box((x, 0, 0), (thickness / 2, height, depth)) for x in uprights]
    if rng.random() < 0.6:
        x, reach = uprights[0], rng.uniform(0.25, 0.55)

        def gusset(p: np.ndarray) -> np.ndarray:
            q = p - np.array([x, base + thickness, 0])
            slope = (np.abs(q[..., 0]) + q[..., 1] - reach) / np.sqrt(2)
            return np.maximum(np.maximum(slope, -q[..., 1]), np.abs(q[..., 2]) - thickness / 2)

        parts.append(intersection(gusset, box((0, 0, 0), (length, height, depth))))
    holes = [
        cylinder(
            (rng.uniform(-0.7, 0.7) * length, base, rng.uniform(-0.4, 0.4) * depth), 1, rng.uniform(0.06, 0.14), 0.5
        )
        for _ in range(rng.integers(1, 4))
    ]
    holes += [cylinder((x, rng.uniform(0.0, 0.6) * height, 0), 0, rng.uniform(0.06, 0.16), 0.4) for x in uprights]
    return difference(union(*parts), *holes)


def lattice(rng: np.random.Generator) -> Shape:
    """A gyroid sheet, a Schwarz P sheet or cubic struts, cut to a box, a cylinder or a ball, on a plate."""
    period, kind = rng.uniform(0.45, 0.8), rng.integers(3)
    k, phase = 2 * np.pi / period, rng.uniform(0, 2 * np.pi, 3)
    thickness = rng.uniform(0.09, 0.16)

    def sheet(p: np.ndarray) -> np.ndarray:
        s, c = np.sin(k * p + phase), np.cos(k * p + phase)
        if kind == 0:
            value = s[..., 0] * c[..., 1] + s[..., 1] * c[..., 2] + s[..., 2] * c[..., 0]
            return np.abs(value) / (1.3 * k) - thickness / 2
        if kind == 1:
            return np.abs(c.sum(axis=-1)) / (1.4 * k) - thickness / 2
        q = np.abs(np.mod(p, period) - period / 2)
        return (
            np.minimum.reduce([np.hypot(q[..., i], q[..., j]) for i, j in ((0, 1), (1, 2), (0, 2))]) - thickness / 1.6
        )

    r = rng.uniform(0.6, 0.9)
    hull = [box((0, 0, 0), (r, r, r)), cylinder((0, 0, 0), 1, r, r), sphere((0, 0, 0), r)][rng.integers(3)]
    plate = intersection(hull, box((0, -r, 0), (r, 0.16 * r + 0.06, r)))
    return union(intersection(sheet, hull), plate)


def vessel(rng: np.random.Generator) -> Shape:
    """A bowl, vase or cup: the shell of a body of revolution with a bottom, sometimes a handle."""
    k, a, b, phase = rng.uniform(1.5, 4.5), rng.uniform(0.3, 0.6), rng.uniform(0.05, 0.2), rng.uniform(0, 2 * np.pi)
    height, thickness, flare = rng.uniform(0.4, 0.9), rng.uniform(0.075, 0.14), rng.uniform(-0.15, 0.3)

    def body(p: np.ndarray, grow: float = 0.0) -> np.ndarray:
        radius = a + flare * p[..., 1] + b * np.sin(k * p[..., 1] + phase) + grow
        return (np.linalg.norm(p[..., [0, 2]], axis=-1) - radius) / 1.15

    outside = intersection(body, box((0, 0, 0), (1, height, 1)))
    hollow = intersection(lambda p: body(p, -thickness), box((0, thickness + 1, 0), (1, height + 1, 1)))
    result = difference(outside, hollow)
    if rng.random() < 0.5:
        radius = a + b * np.sin(phase) - 0.5 * thickness
        handle = torus((radius, rng.uniform(-0.1, 0.2) * height, 0), 2, rng.uniform(0.4, 0.6) * height, thickness * 0.8)
        result = union(result, difference(handle, lambda p: body(p, -0.5 * thickness)))
    return result


def figurine(rng: np.random.Generator) -> Shape:
    """A body, a head, limbs and perhaps ears and a tail, blended; standing, sitting on a base, or on four legs."""
    parts: list[Shape] = []
    head = rng.uniform(0.18, 0.3)
    if rng.random() < 0.5:  # on two legs or sitting
        torso = rng.uniform(0.17, 0.3)
        shoulder, hip, foot = rng.uniform(0.1, 0.25), rng.uniform(-0.45, -0.2), -0.88
        parts.append(capsule((0, hip, 0), (0, shoulder, 0), torso, torso * rng.uniform(0.6, 1.0)))
        top = np.array([0, shoulder + torso * 0.6 + head, rng.uniform(0, 0.12)])
        for side in (-1, 1):
            limb = rng.uniform(0.07, 0.12)
            parts.append(capsule((side * torso * 0.6, hip, 0), (side * torso * 0.8, foot, 0), limb * 1.2, limb))
            hand = (side * (torso + rng.uniform(0.15, 0.4)), rng.uniform(-0.4, 0.4), rng.uniform(-0.1, 0.4))
            parts.append(capsule((side * torso * 0.7, shoulder, 0), hand, limb, limb * 0.8))
    else:
        length, torso, stand = rng.uniform(0.3, 0.5), rng.uniform(0.18, 0.28), rng.uniform(-0.15, 0.05)
        parts.append(capsule((0, stand, -length), (0, stand, length), torso, torso * rng.uniform(0.8, 1.1)))
        top = np.array([0, stand + torso + head * rng.uniform(0.5, 1.0), length + head * rng.uniform(0.2, 0.8)])
        for x in (-1, 1):
            for z in (-0.9, 0.9):
                limb = rng.uniform(0.07, 0.11)
                parts.append(capsule((x * torso * 0.6, stand, z * length), (x * torso * 0.7, -0.8, z * length), limb))
        tail = (rng.uniform(-0.3, 0.3), stand + rng.uniform(-0.2, 0.5), -length - rng.uniform(0.2, 0.4))
        parts.append(capsule((0, stand, -length), tail, 0.07, 0.06))
    parts.append(ellipsoid(top, head * rng.uniform(0.8, 1.2, 3)))
    for side in (-1, 1):
        ear = top + head * np.array([side * 0.6, rng.uniform(0.9, 1.8), 0])
        parts.append(capsule(top + head * np.array([side * 0.5, 0.5, 0]), ear, head * 0.32, head * 0.24))
    body = smooth_union(parts, rng.uniform(0.04, 0.14))
    if rng.random() < 0.4:
        body = union(body, cylinder((0, -0.86, 0), 1, rng.uniform(0.5, 0.8), rng.uniform(0.04, 0.1)))
    return body


FAMILIES: dict[str, Callable[[np.random.Generator], Shape]] = {
    "blobs": blobs,
    "csg": csg,
    "walls": walls,
    "bracket": bracket,
    "lattice": lattice,
    "vessel": vessel,
    "figurine": figurine,
}


def relief(rng: np.random.Generator, amplitude: float, wavelength: float) -> Shape:
    """A smooth random pattern within ±``amplitude``: one to six plane waves, so ridges, eggs or noise."""
    count = int(rng.integers(1, 7))
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    wave = direction * (2 * np.pi / (wavelength * rng.uniform(0.85, 1.2, (count, 1))))
    phase = rng.uniform(0, 2 * np.pi, count)
    # Waves in random phase add up to about √count; the tails beyond the amplitude are cut off.
    height = amplitude / np.sqrt(count)
    return lambda p: np.clip(height * np.cos(p @ wave.T + phase).sum(axis=-1), -amplitude, amplitude)

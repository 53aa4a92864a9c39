"""The two frames an object lives in, and the one scale between them.

*File frame*: the asset's own units, y up. *Normalised frame*: the bounding box centred at the origin and its longest
side 2 · 0.95, so that the object fits the grid [-1, 1]³ with a margin. Millimetres enter through ``size_mm`` only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

HALF_EXTENT = 0.95
"""Half of the longest side in the normalised frame."""


@dataclass(frozen=True)
class Frame:
    """Maps file coordinates to normalised coordinates and to millimetres.

    centre: centre of the bounding box in file units, three floats.
    scale: normalised units per file unit.
    size_mm: the longest side of the printed object.
    """

    centre: tuple[float, float, float]
    scale: float
    size_mm: float

    @classmethod
    def of(cls, vertices: np.ndarray, size_mm: float) -> Frame:
        """The frame of a point set ``[V,3]`` in file units."""
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        longest = float((high - low).max())
        x, y, z = map(float, (low + high) / 2)
        return cls((x, y, z), 2 * HALF_EXTENT / longest, float(size_mm))

    @property
    def mm_per_unit(self) -> float:
        """Millimetres per normalised unit."""
        return self.size_mm / (2 * HALF_EXTENT)

    def normalise(self, points: np.ndarray) -> np.ndarray:
        """File units to the normalised frame, ``[N,3]``."""
        return (points - np.asarray(self.centre)) * self.scale

    def restore(self, points: np.ndarray) -> np.ndarray:
        """The normalised frame back to file units, ``[N,3]``."""
        return points / self.scale + np.asarray(self.centre)

    def to_print(self, points: np.ndarray) -> np.ndarray:
        """The normalised frame to millimetres on the print bed: z up, base on z = 0, ``[N,3]``.

        A rotation by 90° about x takes y up to z up; it keeps the orientation of the faces.
        """
        mm = np.asarray(points, dtype=np.float64) * self.mm_per_unit
        mm = np.stack([mm[:, 0], -mm[:, 2], mm[:, 1]], axis=1)
        mm[:, 2] -= mm[:, 2].min()
        return mm

    def from_print(self, points_mm: np.ndarray, base: float) -> np.ndarray:
        """The inverse of :meth:`to_print`, for a part whose lowest point is at ``base`` in the normalised frame."""
        mm = np.asarray(points_mm, dtype=np.float64)
        return np.stack([mm[:, 0], mm[:, 2], -mm[:, 1]], axis=1) / self.mm_per_unit + np.array([0.0, base, 0.0])

"""The two frames an object lives in, and the one scale between them.

*File frame*: the asset's own units, y up. *Normalised frame*: the bounding box centred at the origin and its longest
side 2 · 0.95, so that the object fits the grid [-1, 1]³ with a margin. Millimetres enter through ``size_mm`` only.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

HALF_EXTENT = 0.95
"""Half of the longest side in the normalised frame."""
Up = tuple[float, float, float]
"""Unit vector away from the print bed, in the normalised frame."""
UPRIGHT: Up = (0.0, 1.0, 0.0)
"""Of a part that is printed as the object stands."""
DIRECTIONS: dict[str, Up] = {
    "upright": UPRIGHT,
    "upside-down": (0.0, -1.0, 0.0),
    "on-back": (0.0, 0.0, 1.0),
    "on-front": (0.0, 0.0, -1.0),
    "on-left": (1.0, 0.0, 0.0),
    "on-right": (-1.0, 0.0, 0.0),
}
"""What points away from the print bed, by the way of standing."""
_UPRIGHT_AXES = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""The axes of the print frame in the normalised one, as rows, of a part that is printed as it stands: 90° about x."""


@dataclass(frozen=True)
class Frame:
    """Maps file coordinates to normalised coordinates and to millimetres.

    centre: centre of the bounding box in file units, three floats.
    scale: normalised units per file unit.
    size_mm: the longest side of the printed object.
    up: the way the part is printed.
    """

    centre: tuple[float, float, float]
    scale: float
    size_mm: float
    up: Up = UPRIGHT

    @classmethod
    def of(cls, vertices: np.ndarray, size_mm: float) -> Frame:
        """The frame of a point set ``[V,3]`` in file units."""
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        longest = float((high - low).max())
        x, y, z = map(float, (low + high) / 2)
        return cls((x, y, z), 2 * HALF_EXTENT / longest, float(size_mm))

    def standing(self, up: Up) -> Frame:
        """The same, printed with ``up`` away from the bed."""
        return replace(self, up=up)

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
        """The normalised frame to millimetres on the print bed: z up, base on z = 0, ``[N,3]``."""
        mm = self.turned_to_print(points) * self.mm_per_unit
        mm[:, 2] -= mm[:, 2].min()
        return mm

    def from_print(self, points_mm: np.ndarray, base: float) -> np.ndarray:
        """The inverse of :meth:`to_print`, for a part whose lowest point is at ``base`` along ``up``."""
        return self.turned_from_print(points_mm) / self.mm_per_unit + base * np.array(self.up)

    def turned_to_print(self, vectors: np.ndarray) -> np.ndarray:
        """Vectors ``[N,3]`` of the normalised frame along the axes of the print bed; their length stays."""
        return np.asarray(vectors, dtype=np.float64) @ self._axes.T

    def turned_from_print(self, vectors: np.ndarray) -> np.ndarray:
        """The inverse of :meth:`turned_to_print`."""
        return np.asarray(vectors, dtype=np.float64) @ self._axes

    @property
    def _axes(self) -> np.ndarray:
        """The axes of the print frame in the normalised one, as rows; a rotation keeps the orientation of faces."""
        up, y = np.array(self.up), np.array([0.0, 1.0, 0.0])
        if up[1] < -1 + 1e-9:
            return _UPRIGHT_AXES @ np.diag([1.0, -1.0, -1.0])
        # The shortest turn that takes up to y (Rodrigues' formula)
        x, _, z = np.cross(up, y)
        cross = np.array([[0.0, -z, 0.0], [z, 0.0, -x], [0.0, x, 0.0]])
        return _UPRIGHT_AXES @ (np.eye(3) + cross + cross @ cross / (1 + up[1]))

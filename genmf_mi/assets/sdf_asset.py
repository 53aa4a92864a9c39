"""A shape as Φ on a grid, in the same frame and with the same sign whichever generator wrote it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from genmf_mi.assets.asset import Asset
from genmf_mi.assets.maps import Look
from genmf_mi.core.errors import AssetError
from genmf_mi.mesh.measures import vertex_normals

if TYPE_CHECKING:
    from genmf_mi.sdf.flexicubes import FlexiCubes

MAX_SAMPLES = 513
"""Samples per axis that are accepted at most; Φ alone takes 0.5 GB then."""


@dataclass(frozen=True, eq=False)
class SdfAsset:
    """Φ on a grid and the parameters with which FlexiCubes meshes it, y up. The grid is [-1, 1]³ in *grid units*.

    phi: float32 ``[m,m,m]``, indexed x, y, z, negative inside, positive on the border. About a distance in grid units
        near the surface; farther away only its sign is reliable, unless it is from :func:`from_mesh.sdf_from_mesh`.
    deformation: float32 ``[m,m,m,3]``, displacement of the samples in grid units, or None.
    weights: float32 ``[K,21]``, unbounded weights as defined in :mod:`genmf_mi.sdf.flexicubes`, or None.
    rows: int32 ``[n³]``, n = m - 1: which of the K rows a cube has, -1 for none. None if each has its own, K = n³.
    spread: of the weights, see :class:`FlexiCubes`.
    centre, half: the centre of the grid and half its side, in file units.
    coloured: a surface with the object's colours, in file units, or None if it has none.
    report: what was changed on the way from the file.

    Raises:
        AssetError: an array has the wrong size or values that are not finite, samples are displaced by more than half a
            cell, or no surface lies inside of the grid.
    """

    name: str
    phi: np.ndarray
    deformation: np.ndarray | None = None
    weights: np.ndarray | None = None
    rows: np.ndarray | None = None
    spread: float = 0.99
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)
    half: float = 1.0
    coloured: Asset | None = None
    source: Path | None = None
    report: dict[str, Any] = field(default_factory=dict[str, Any])

    def __post_init__(self) -> None:
        m, where = len(self.phi) if np.ndim(self.phi) else 0, self.source or self.name
        if np.shape(self.phi) != (m, m, m) or not 4 <= m <= MAX_SAMPLES:
            raise AssetError(
                f"{where}: phi must be a cube of 4 to {MAX_SAMPLES} samples per axis, not {np.shape(self.phi)}."
            )
        count = (m - 1) ** 3
        if self.rows is not None:
            count = 0 if self.weights is None else len(self.weights)
        for name, shape in (("deformation", (m, m, m, 3)), ("weights", (count, 21)), ("rows", ((m - 1) ** 3,))):
            array = getattr(self, name)
            if array is not None and np.shape(array) != shape:
                raise AssetError(f"{where}: {name} must have the shape {shape} for {m} samples, not {np.shape(array)}.")
        for name in ("phi", "deformation", "weights"):
            array = getattr(self, name)
            if array is not None and not np.isfinite(array).all():
                raise AssetError(f"{where}: {name} has values that are not finite numbers. Generate it again.")
        if self.rows is not None and not -1 <= self.rows.min() <= self.rows.max() < count:
            raise AssetError(f"{where}: rows point to weights that do not exist.")
        if self.deformation is not None and np.abs(self.deformation).max() > (1 + 1e-4) / (m - 1):
            raise AssetError(f"{where}: deformation moves samples by more than half a cell, so that cells would fold.")
        if not (0 < self.spread < 1 and self.half > 0 and np.isfinite([self.half, *self.centre]).all()):
            raise AssetError(f"{where}: spread must be between 0 and 1, half positive, and centre three numbers.")
        if not (self.phi < 0).any():
            raise AssetError(f"{where}: the level set is empty, phi is negative nowhere. Generate it again.")
        if min(side.min() for axis in range(3) for side in np.moveaxis(self.phi, axis, 0)[[0, -1]]) < 0:
            raise AssetError(f"{where}: phi is negative on the border of its grid, so the surface is open there.")

    @property
    def resolution(self) -> int:
        """n, cells per axis."""
        return len(self.phi) - 1

    @property
    def textured(self) -> bool:
        """Whether the colour varies, so that there is detail for the relief to show."""
        return self.coloured is not None and self.coloured.textured

    @property
    def notes(self) -> tuple[str, ...]:
        """What was left out or mended on reading the surface with the colours."""
        return () if self.coloured is None else self.coloured.notes

    def extractor(self, device: str = "cpu") -> FlexiCubes:
        """Extracts surfaces from ``phi``, ``deformation`` and ``weights`` as tensors."""
        import torch

        from genmf_mi.sdf.flexicubes import FlexiCubes

        return FlexiCubes(self.spread, None if self.rows is None else torch.as_tensor(self.rows, device=device))

    def surface(self, training: bool = False) -> tuple[np.ndarray, np.ndarray]:
        """Vertices ``float64 [V,3]`` in file units and faces ``int64 [F,3]``, closed and oriented outwards."""
        import torch

        options = [None if array is None else torch.as_tensor(array) for array in (self.deformation, self.weights)]
        surface = self.extractor()(torch.as_tensor(self.phi), *options, training=training)
        return self.restore(surface.vertices.double().numpy()), surface.faces.numpy()

    def restore(self, points: np.ndarray) -> np.ndarray:
        """Grid units to file units, ``[N,3]``."""
        return points * self.half + np.asarray(self.centre)

    def to_grid(self, points: np.ndarray) -> np.ndarray:
        """File units to grid units, ``[N,3]``."""
        return (points - np.asarray(self.centre)) / self.half

    def closest_albedo(self, points: np.ndarray, normals: np.ndarray | None = None) -> np.ndarray:
        """Linear RGB ``float32 [N,3]`` at ``points [N,3]`` in file units, as :meth:`Asset.closest_albedo`; white if the
        object has no colours."""
        if self.coloured is None:
            return np.ones((len(points), 3), np.float32)
        return self.coloured.closest_albedo(points, normals)

    def look(self, points: np.ndarray, normals: np.ndarray, spacing: float = 0.0) -> Look | None:
        """As :meth:`Asset.look`, of the surface with the colours."""
        return None if self.coloured is None else self.coloured.look(points, normals, spacing)

    def with_maps(self, *, normal: bool, occlusion: bool, emission: bool) -> SdfAsset:
        """As :meth:`Asset.with_maps`, of the surface with the colours."""
        if self.coloured is None or not self.coloured.maps:
            return self
        return replace(self, coloured=self.coloured.with_maps(normal=normal, occlusion=occlusion, emission=emission))

    def as_mesh(self) -> Asset:
        """The extracted surface with its colours per vertex."""
        vertices, faces = self.surface(training=True)
        colours = self.closest_albedo(vertices, vertex_normals(vertices, faces))
        return Asset.from_arrays(self.name, vertices, faces, colours=colours)

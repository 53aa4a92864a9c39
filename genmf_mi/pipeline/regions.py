"""Where a part shall have no relief, more of it, or matters most: from the settings of a run to numbers per vertex."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from genmf_mi.assets import masks
from genmf_mi.assets.asset import Asset
from genmf_mi.assets.masks import Mask
from genmf_mi.assets.sdf_asset import SdfAsset
from genmf_mi.core.config import RefineConfig
from genmf_mi.core.errors import ConfigError
from genmf_mi.core.frame import Frame
from genmf_mi.core.regions import VERTEX_COLOURS, Regions, Stroke
from genmf_mi.geometry.fade import faded
from genmf_mi.geometry.strokes import Label, painted
from genmf_mi.mesh.measures import vertex_areas
from genmf_mi.mesh.nearest import barycentric, closest_points
from genmf_mi.pipeline.run_folder import REPLACEMENT, RunFolder, fingerprint

FLAT = 1e-3
"""Share of the cap below which a mask asks for a flat surface: black of an image that was compressed is not quite 0."""
DETOUR = 2 / 3**0.5
"""Length of a way along the edges of equilateral triangles over that of the straight one, at most."""
NEXT_TO_NOTHING = 1e-6
"""Share of the cap that counts as none, for round-off."""


@dataclass(frozen=True)
class RegionField:
    """What is asked for at each vertex of a surface; three ``[V]``.

    mask: 0 where the surface shall stay as it is, 1 where it may have all of its relief.
    strength: factor on the cap, 1 or more. weight: factor on what the appearance counts in the loss, 1 or more.
    """

    mask: np.ndarray
    strength: np.ndarray
    weight: np.ndarray

    @property
    def cap(self) -> np.ndarray:
        """``[V]``: factor on the cap of the relief."""
        return self.mask * self.strength

    @property
    def relief(self) -> np.ndarray:
        """``bool [V]``: where there may be any relief."""
        return self.mask > 0

    def of_faces(self, faces: np.ndarray) -> np.ndarray:
        """``[F]``: how much fine triangles matter, 0 where all corners are flat."""
        return np.where(self.relief[faces].any(axis=1), self.weight[faces].max(axis=1), 0.0)

    def areas_cm2(self, vertices_mm: np.ndarray, faces: np.ndarray) -> dict[str, float]:
        """What is flat, fades, may be higher, and counts more."""
        area = vertex_areas(vertices_mm, faces) / 100
        parts = {
            "flat_cm2": self.mask == 0,
            "fading_cm2": (self.mask > 0) & (self.mask < 1),
            "stronger_cm2": (self.strength > 1) & self.relief,
            "weighted_cm2": (self.weight > 1) & self.relief,
            "whole_cm2": np.ones(len(area), bool),
        }
        return {name: float(area[chosen].sum()) for name, chosen in parts.items()}


@dataclass(frozen=True, eq=False)
class AssetRegions:
    """What is asked for on an asset.

    strokes: in file coordinates, as :class:`Regions` has them. masks: of the files and names that were given.
    fade_mm: width of the strip beside what is flat or stronger.
    """

    strokes: tuple[Stroke, ...]
    masks: tuple[Mask, ...]
    fade_mm: float

    def on(self, vertices: np.ndarray, faces: np.ndarray, normals: np.ndarray, frame: Frame) -> RegionField:
        """At the vertices ``[V,3]`` of a surface, in file units; normals ``[V,3]`` of unit length, faces ``[F,3]``.

        A triangle that something flat reaches into is flat as a whole, and the fade begins beside it.
        """
        mm = frame.normalise(vertices) * frame.mm_per_unit
        mask = np.ones(len(vertices))
        for each in self.masks:
            mask = np.minimum(mask, each(vertices, normals))
        mask[mask < FLAT] = 0
        mask[_touched(faces, mask == 0)] = 0
        # Strokes have outlines finer than the mesh: with a whole triangle beside them flat, they keep these
        edge = _longest_edge(mm, faces)
        strength, weight = np.ones(len(vertices)), np.ones(len(vertices))
        reach = self.fade_mm + float(edge.max())
        for (kind, factor), distance in self._distances(mm, normals, frame, reach).items():
            # Where strokes were erased, outlines are left of which nothing is inside
            inside = faded(np.where(distance <= 0, 0.0, 9 * reach), mm, faces, 1.0)
            distance = np.maximum(distance, np.where(distance <= 0, distance, inside / DETOUR - edge))
            if kind == "flat":
                mask = np.minimum(mask, np.clip((distance - edge) / self.fade_mm, 0, 1))
                continue
            more = 1 + (factor - 1) * np.clip(1 - distance / self.fade_mm, 0, 1)
            weight = np.maximum(weight, more)
            if kind == "stronger":
                strength = np.maximum(strength, more)
        return RegionField(faded(mask, mm, faces, self.fade_mm), strength, weight)

    def _distances(
        self, points_mm: np.ndarray, normals: np.ndarray, frame: Frame, reach: float
    ) -> dict[Label, np.ndarray]:
        placed = [replace(s, points=frame.normalise(s.points) * frame.mm_per_unit) for s in self.strokes]
        return painted(points_mm, normals, placed, reach) if placed else {}


def of_asset(
    asset: Asset | SdfAsset, config: RefineConfig, up: str | None = None
) -> tuple[Asset | SdfAsset, AssetRegions | None]:
    """The regions that the settings ask for, None if for none; and the asset, without the vertex colours that were a
    mask.

    Args:
        up: of the asset's file, see :func:`genmf_mi.load`; a mesh for a mask is read likewise.

    Raises:
        ConfigError: a file cannot be read, a name is not in the asset's file, or a factor lifts the cap too high.
    """
    if not given(config):
        return asset, None
    strokes = regions_of(config)
    _require_low(strokes, config)
    found: list[Mask] = []
    coloured = asset.coloured if isinstance(asset, SdfAsset) else asset
    if config.mask is None and not (config.flat_material or config.flat_faces):
        return asset, AssetRegions(strokes, (), config.mask_fade_mm)
    if coloured is None:
        raise ConfigError(
            f"{asset.name} has no mesh for a mask or names: paint strokes (--regions), or give --textured."
        )
    if config.flat_material or config.flat_faces:
        found.append(masks.of_names(coloured, config.flat_material, config.flat_faces))
    if config.mask is not None:
        path = Path(config.mask)
        if str(path) == VERTEX_COLOURS:
            coloured, mask = masks.of_vertex_colours(coloured)
            asset = replace(asset, coloured=coloured) if isinstance(asset, SdfAsset) else coloured
        else:
            mask = masks.of_mesh(path, up) if masks.is_mesh(path) else masks.of_image(coloured, path)
        found.append(mask)
    return asset, AssetRegions(strokes, tuple(found), config.mask_fade_mm)


def given(config: RefineConfig) -> bool:
    """Whether the settings ask for any region."""
    return bool(config.regions or config.mask or config.flat_material or config.flat_faces)


def regions_of(config: RefineConfig) -> tuple[Stroke, ...]:
    """The strokes of the settings. Raises :class:`ConfigError`."""
    if config.regions is None:
        return ()
    return (config.regions if isinstance(config.regions, Regions) else Regions.read(config.regions)).strokes


def copies(config: RefineConfig) -> dict[str, bytes]:
    """What a run keeps of its regions, by the names that :meth:`RefineConfig.to_dict` gives these files.

    Raises:
        ConfigError: a file cannot be read.
    """
    told, kept = config.to_dict(), dict[str, bytes]()
    if config.regions is not None:
        kept[told["regions"]] = Regions(regions_of(config)).to_json().encode()
    if config.mask is not None and told["mask"] != VERTEX_COLOURS:
        try:
            kept[told["mask"]] = Path(config.mask).read_bytes()
        except OSError as error:
            raise ConfigError(f"cannot read the mask {config.mask}: {error.strerror}.") from error
    return kept


def fingerprints(kept: Mapping[str, bytes]) -> dict[str, str]:
    """Of the content of :func:`copies`, for :meth:`RunFolder.require`."""
    return {Path(name).stem: fingerprint(content) for name, content in kept.items()}


def told(
    field: RegionField, vertices: np.ndarray, faces: np.ndarray, foot: np.ndarray, distance_mm: np.ndarray, frame: Frame
) -> dict[str, float]:
    """Areas of the regions, and how far the surface moved where it should stay as it is.

    Args:
        field: at the ``vertices [V,3]`` of the initial surface, normalised frame; faces ``[F,3]``.
        foot: ``[N,3]``, the points of that surface that came to be the vertices of the part.
        distance_mm: ``[N]``, how far these moved.
    """
    face, closest, _ = closest_points(foot, vertices, faces)
    corners = faces[face]
    mask = np.einsum("nc,nc->n", barycentric(vertices[corners], closest), field.mask[corners])
    flat = distance_mm[mask < NEXT_TO_NOTHING]
    return field.areas_cm2(vertices * frame.mm_per_unit, faces) | {"flat_max_relief_mm": float(flat.max(initial=0.0))}


def resumed(config: RefineConfig, run: RunFolder) -> RefineConfig:
    """The settings with the regions of an interrupted run, unless they have some of their own."""
    grown = RunFolder(run.path / REPLACEMENT)  # one that replaces a complete run goes on there
    run = grown if grown.interrupted else run
    if given(config) or not run.interrupted:
        return config
    settings = run.settings()
    kept: dict[str, Any] = {
        name: settings[name] for name in ("mask_fade_mm", "flat_material", "flat_faces") if name in settings
    }
    for name in ("regions", "mask"):
        file = settings.get(name)
        if file is not None:
            kept[name] = file if file == VERTEX_COLOURS else run.path / str(file)
    for name in ("flat_material", "flat_faces"):
        kept[name] = tuple(kept.get(name) or ())
    return replace(config, **kept)


def _require_low(strokes: Sequence[Stroke], config: RefineConfig) -> None:
    factor = max((s.factor for s in strokes if s.kind == "stronger"), default=1.0)
    if factor * config.max_relief_mm > config.size_mm / 10:
        raise ConfigError(
            f"a stroke of the factor {factor:g} makes the relief {factor * config.max_relief_mm:g} mm, more than a "
            f"tenth of size-mm {config.size_mm:g}: lower it, or max-relief-mm."
        )


def _touched(faces: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """The vertices of all faces that have a ``chosen [V]`` one."""
    return np.unique(faces[chosen[faces].any(axis=1)])


def _longest_edge(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """``[V]`` length of the longest edge of the faces around each vertex."""
    corners = vertices[faces]
    longest = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2).max(axis=1)
    result = np.zeros(len(vertices))
    for corner in faces.T:
        np.maximum.at(result, corner, longest)
    return result

"""A textured mesh from any of the usual file formats, exactly as the file stores it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from genmf_mi.assets import maps
from genmf_mi.assets.albedo import Albedo, Material, Texture
from genmf_mi.assets.maps import Look, PlacedMaps
from genmf_mi.assets.overlays import Overlay, outermost, split
from genmf_mi.assets.part import Names, Part, groups, join, placed_maps
from genmf_mi.assets.reading import reading
from genmf_mi.assets.suffixes import MESHES
from genmf_mi.core.errors import AssetError, ConfigError, GenmfError
from genmf_mi.core.text import printable
from genmf_mi.mesh.nearest import Nearest, barycentric

LARGEST_COORDINATE, FARTHEST = 1e15, 1e5
"""Of a vertex, in file units; and extent of an asset over that of all of it but a hundredth."""
LARGEST_UV = 1e7
"""Texture coordinates of 32 bits know no place in a texture from here on."""
SMALLEST_SIDE = 1e-30
"""Of an asset, in file units: 32-bit floats end at 1e-38, and need seven more digits."""
_UP = {".3mf": "z", ".stl": "z"}
_TO_Y_UP = {
    "x": [[0, -1, 0], [1, 0, 0], [0, 0, 1]],
    "-x": [[0, 1, 0], [-1, 0, 0], [0, 0, 1]],
    "y": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "-y": [[-1, 0, 0], [0, -1, 0], [0, 0, 1]],
    "z": [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
    "-z": [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
}
"""Rotations that take an axis of a file to y."""


@dataclass(frozen=True, eq=False)
class Asset:
    """A triangle mesh with colour, in file units and y up.

    vertices: ``float64 [V,3]``; UV seams are not welded.
    faces: ``int64 [F,3]``.
    albedo: the colour of every face, linear RGB.
    source: the file that it was read from, or None.
    maps: normal, occlusion and emissive maps, of some faces each.
    notes: what was left out or mended on reading, a sentence each.
    groups: what the file calls its parts: the names of an OBJ's objects and groups, of a glTF's nodes and meshes, of a
        3MF's objects. A part may have several names, or none.
    group: ``int64 [F]``, which of ``groups`` a face is in.
    """

    name: str
    vertices: np.ndarray
    faces: np.ndarray
    albedo: Albedo
    source: Path | None = None
    maps: tuple[PlacedMaps, ...] = ()
    notes: tuple[str, ...] = ()
    groups: tuple[Names, ...] = ((),)
    group: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))

    @classmethod
    def from_arrays(
        cls,
        name: str,
        vertices: np.ndarray,
        faces: np.ndarray,
        *,
        uv: np.ndarray | None = None,
        texture: np.ndarray | None = None,
        colours: np.ndarray | None = None,
    ) -> Asset:
        """An asset from arrays in memory.

        Args:
            vertices: ``[V,3]``, y up.
            faces: ``[F,3]``, counter-clockwise seen from outside.
            uv: ``[V,2]`` with v downwards, needed with ``texture``.
            texture: sRGB-encoded ``uint8 [H,W,3]``, row 0 at v = 0, repeated outside of 0..1.
            colours: linear RGB vertex colours ``[V,3]``, multiplied with the texture if both are given.

        Raises:
            AssetError: the arrays are not a finite triangle mesh, or do not fit each other.
        """
        vertices = np.asarray(vertices, dtype=np.float64).reshape(-1, 3)
        for array, width in ((uv, 2), (colours, 3)):
            if array is not None and np.shape(array) != (len(vertices), width):
                raise AssetError(f"{name}: an array of shape {np.shape(array)} does not fit {len(vertices)} vertices.")
        if texture is not None and uv is None:
            raise AssetError(f"{name}: a texture needs texture coordinates.")
        material = Material(texture=None if texture is None else Texture(np.asarray(texture, dtype=np.uint8)))
        faces = np.asarray(faces, dtype=np.int64).reshape(-1, 3)
        return cls._from_parts(name, [Part(vertices, faces, material, uv, colours)])

    @classmethod
    def _from_parts(cls, name: str, parts: list[Part], source: Path | None = None) -> Asset:
        where = source or name
        parts = [part for part in parts if len(part.faces)]
        if not parts:
            raise AssetError(f"{where} holds no triangles. Export the mesh itself, not points or an empty scene.")
        vertices, faces, albedo = join(parts)
        if not 0 <= faces.min() <= faces.max() < len(vertices):
            raise AssetError(f"{where} has faces that point to missing vertices. Export it again.")
        used = vertices[faces]
        if not np.isfinite(used).all():
            raise AssetError(f"{where} has vertices that are not numbers (NaN or infinite). Repair or export it again.")
        placed = placed_maps(parts)
        _require_sane(where, used.reshape(-1, 3), albedo, placed)
        if np.ptp(used.reshape(-1, 3), axis=0).max() == 0:
            raise AssetError(f"{where} has no size: all its vertices are in one place. Export it again.")
        notes = tuple(dict.fromkeys(note for part in parts for note in part.notes))
        return cls(printable(name), vertices, faces, albedo, source, placed, notes, *groups(parts))

    @property
    def textured(self) -> bool:
        """Whether the colour varies, so that there is detail for the relief to show."""
        return self.albedo.varies or bool(self.maps)

    @property
    def matter(self) -> np.ndarray:
        """``[F,3]``: the faces that make the shape, which decals do not."""
        decals = [overlay.faces for overlay in self._layers[2] if overlay.decal]
        return np.delete(self.faces, np.concatenate(decals), axis=0) if decals else self.faces

    def albedo_at(self, face_index: np.ndarray, barycentric: np.ndarray) -> np.ndarray:
        """Linear RGB ``float32 [N,3]`` at ``barycentric [N,3]`` of the faces ``face_index [N]``."""
        return self.albedo.sample(self.faces, face_index, barycentric)

    def closest_albedo(self, points: np.ndarray, normals: np.ndarray | None = None) -> np.ndarray:
        """Linear RGB ``float32 [N,3]`` of the surface nearest to ``points [N,3]`` in file units.

        With ``normals [N,3]`` of unit length, a face that points the other way is replaced by one within 2 % of the
        longest side that does not, so that the inside of a thin wall does not take the colour of its outside; and
        decals and what is printed on a transparent shell cover what is below them.
        """
        return self.albedo_at(*self._seen(points, normals))

    def look(self, points: np.ndarray, normals: np.ndarray, spacing: float = 0.0) -> Look | None:
        """What the maps make of ``points [N,3]`` in file units with ``normals [N,3]`` of unit length, in the place of
        :meth:`closest_albedo`; None if there are none. spacing: see :func:`genmf_mi.assets.maps.look`."""
        if not self.maps:
            return None
        return maps.look(self.maps, self.vertices, self.faces, *self._seen(points, normals), normals, spacing)

    def with_maps(self, *, normal: bool, occlusion: bool, emission: bool) -> Asset:
        """The same with the maps that are wanted only."""
        kept = [
            replace(each, maps=each.maps.only(normal=normal, occlusion=occlusion, emission=emission))
            for each in self.maps
        ]
        return replace(self, maps=tuple(each for each in kept if each.maps.present)) if self.maps else self

    def _seen(self, points: np.ndarray, normals: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """The faces ``[N]`` that are seen at ``points``, and where on them, barycentric ``[N,3]``."""
        index, closest = self.locate(points, normals)
        return index, barycentric(self.vertices[self.faces[index]], closest)

    def locate(self, points: np.ndarray, normals: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """The face ``[N]`` whose colour :meth:`closest_albedo` gives to each point, and the point ``[N,3]`` of it."""
        points = np.ascontiguousarray(points, dtype=np.float64)
        body, nearest, overlays = self._layers
        index, closest, _ = nearest.find(points)
        if normals is not None:
            index, closest = nearest.on_agreeing_faces(points, np.asarray(normals), index, closest)
        index = body[index]
        if normals is not None and overlays:
            below = index, closest
            index, closest = outermost(
                overlays, points, np.asarray(normals), below, self.vertices, self.faces, self.albedo
            )
        return index, closest

    @cached_property
    def _layers(self) -> tuple[np.ndarray, Nearest, list[Overlay]]:
        """The faces of the body ``[B]`` and what finds the nearest of them, and what lies over it."""
        body, groups = split(self.vertices, self.faces, self.albedo)
        over = [Overlay.of(rows, self.vertices, self.faces, self.albedo) for rows in groups]
        return body, Nearest(self.vertices, self.faces[body]), over


def _require_sane(where: object, points: np.ndarray, albedo: Albedo, placed: tuple[PlacedMaps, ...]) -> None:
    """Raise :class:`AssetError` for what would be refused after the optimisation, or break native code.

    points: ``[N,3]``, corners of all faces.
    """
    if np.abs(points).max() > LARGEST_COORDINATE:
        raise AssetError(f"{where} has coordinates of {np.abs(points).max():.0e}. Scale it down and export it again.")
    low, inner_low, inner_high, high = np.percentile(points, [0, 1, 99, 100], axis=0)
    if 0 < (high - low).max() < SMALLEST_SIDE:
        raise AssetError(
            f"{where} is {(high - low).max():.0e} units large, which its files cannot hold. Scale it up and export it "
            "again."
        )
    inner = (inner_high - inner_low).max()
    if (high - low).max() > FARTHEST * inner > 0:
        raise AssetError(
            f"{where} has a few vertices {(high - low).max() / inner:.0e} times farther away than the rest is large. "
            "Delete them and export it again."
        )
    for what, values in (("texture coordinates", albedo.uv), ("colours", albedo.colours)):
        if not np.isfinite(values).all():
            raise AssetError(f"{where} has {what} that are not numbers (NaN or infinite). Repair or export it again.")
    if not np.isfinite([material.factor for material in albedo.materials]).all():
        raise AssetError(f"{where} has a base colour that is no number (NaN or infinite). Repair or export it again.")
    if np.abs(albedo.uv).max(initial=0) > LARGEST_UV:
        raise AssetError(f"{where} has texture coordinates of {np.abs(albedo.uv).max():.0e}. Export it again.")
    if not (np.abs([each.maps.emission for each in placed]) < LARGEST_COORDINATE).all():
        raise AssetError(f"{where} has an emissive colour that is no sensible number. Export it again.")


def load(path: str | Path, up: str | None = None, *, files_anywhere: bool = False) -> Asset:
    """Read a GLB, GLTF, OBJ (with MTL), PLY, 3MF or STL file.

    Colours become linear RGB. By their specification glTF textures are sRGB-encoded and its factors and vertex colours
    (COLOR_0) linear; every colour of the other formats is taken as sRGB-encoded, as their writers mean them.

    Args:
        up: ``x``, ``-x``, ``y``, ``-y``, ``z`` or ``-z``, the axis of the file that points upwards; None takes z for
            3MF and STL and y otherwise.
        files_anywhere: let it name textures, materials and buffers outside of its own folder.

    Raises:
        AssetError: the file is missing, damaged, of an unknown kind, or holds no mesh; or a texture is missing.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if not path.is_file():
        problem = "is a folder" if path.is_dir() else "does not exist"
        raise AssetError(f"{path} {problem}. Check the spelling, or give the full path of the file.")
    if suffix not in MESHES:
        raise AssetError(f"{path} is of an unknown kind ({suffix or 'no suffix'}). Use one of {', '.join(MESHES)}.")
    if path.stat().st_size == 0:
        raise AssetError(f"{path} is empty. Download or export it again.")
    try:
        with reading(anywhere=files_anywhere):
            parts = _reader(suffix)(path)
    except GenmfError:
        raise
    except Exception as error:  # third-party parsers raise anything at all on damaged files
        raise AssetError(
            f"{path} cannot be read as {suffix[1:].upper()} ({type(error).__name__}: {error}). "
            "Download or export it again."
        ) from error
    turn = np.eye(4)
    turn[:3, :3] = turn_of(path, up)
    if not np.array_equal(turn, np.eye(4)):
        parts = [part.transformed(turn) for part in parts]
    return Asset._from_parts(path.stem, parts, path)


def turn_of(path: str | Path, up: str | None = None) -> np.ndarray:
    """The rotation ``[3,3]`` from a file to y up, as :func:`load` makes it. Raises :class:`ConfigError`."""
    axis = up or _UP.get(Path(path).suffix.lower(), "y")
    if axis not in _TO_Y_UP:
        raise ConfigError(f"{axis} is no axis that could point upwards: choose one of {', '.join(_TO_Y_UP)}.")
    return np.array(_TO_Y_UP[axis], dtype=np.float64)


def _reader(suffix: str) -> Callable[[Path], list[Part]]:
    """The function that reads files of this suffix; its libraries are loaded only when it is needed."""
    if suffix in (".glb", ".gltf"):
        from genmf_mi.assets.formats.gltf import read
    elif suffix == ".obj":
        from genmf_mi.assets.formats.obj import read
    elif suffix == ".3mf":
        from genmf_mi.assets.formats.threemf import read
    elif suffix == ".stl":
        from genmf_mi.assets.formats.stl import read
    else:
        from genmf_mi.assets.formats.ply import read
    return read

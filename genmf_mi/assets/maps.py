"""What a glTF material has beside its base colour: normal, occlusion and emissive maps.

A normal map is geometry that the texture pretends: it tilts the normal that a point is shaded by. It is applied to the
normal of the part, and not to the vertex normals of the file, so that a flat map changes nothing.
Section numbers are those of the Khronos glTF 2.0 specification.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from genmf_mi.assets.albedo import Texture
from genmf_mi.mesh.measures import face_areas

AMBIENT = 0.2
"""Share of the light that an occlusion map can take away, as in ``scenes/default.xml``: the ambient one."""
_NUMBERS = (np.arange(256) / 255).astype(np.float32)
_SIGNED = (np.arange(256) / 127.5 - 1).astype(np.float32)
_SIGNED[127:129] = 0  # no byte says 0, and a flat map is to change nothing
_DARK = 8
"""Bytes up to which a texel does not glow."""


@dataclass(frozen=True, eq=False)
class Layer:
    """A picture, and where it lies: ``uv [V,2]`` at the vertices of the part, v downwards."""

    texture: Texture
    uv: np.ndarray

    @property
    def placed_uv(self) -> np.ndarray:
        """``[V,2]`` after the transform of the texture."""
        return self.uv @ self.texture.transform[:, :2].T + self.texture.transform[:, 2]


@dataclass(frozen=True, eq=False)
class Maps:
    """The maps of some faces, each None where there is none.

    normal: tangent space, green up (3.9.3), x and y multiplied by ``scale``. tangents, bitangents: ``[V,3]`` of the
    file; None takes those of the texture coordinates. occlusion: in red, as far as ``strength``, 0 to 1.
    emissive: sRGB-encoded, multiplied by ``emission``, linear RGB, which counts alone without it.
    """

    normal: Layer | None = None
    scale: float = 1.0
    tangents: np.ndarray | None = None
    bitangents: np.ndarray | None = None
    occlusion: Layer | None = None
    strength: float = 1.0
    emissive: Layer | None = None
    emission: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def present(self) -> bool:
        """Whether they change what is seen."""
        return self.normal is not None or self.occlusion is not None or any(self.emission)

    def turned(self, matrix: np.ndarray) -> Maps:
        """With tangents and bitangents under a linear ``matrix [3,3]``, or one for each vertex ``[V,3,3]``."""
        if self.tangents is None or self.bitangents is None:
            return self
        turned = (np.einsum("...ij,...j->...i", matrix, each) for each in (self.tangents, self.bitangents))
        return replace(self, **dict(zip(("tangents", "bitangents"), turned, strict=True)))

    def only(self, *, normal: bool, occlusion: bool, emission: bool) -> Maps:
        """Those that are wanted."""
        return replace(
            self,
            normal=self.normal if normal else None,
            occlusion=self.occlusion if occlusion else None,
            emissive=self.emissive if emission else None,
            emission=self.emission if emission else (0.0, 0.0, 0.0),
        )


NO_MAPS = Maps()


@dataclass(frozen=True, eq=False)
class PlacedMaps:
    """The maps of the faces ``first_face`` to ``end_face`` of an asset, whose vertices begin at ``first_vertex``."""

    maps: Maps
    first_face: int
    end_face: int
    first_vertex: int


@dataclass(frozen=True, eq=False)
class Look:
    """How maps change the look of points.

    normals: ``[N,3]``, to shade by. occlusion: ``[N]``, 0 to 1, what arrives of the ambient light. emission: linear RGB
    ``[N,3]``.
    """

    normals: np.ndarray
    occlusion: np.ndarray
    emission: np.ndarray

    def colour(self, albedo: np.ndarray) -> np.ndarray:
        """Linear RGB ``[N,3]`` of points of this albedo in full light, as a screen shows it."""
        ambient = (1 - AMBIENT * (1 - self.occlusion))[:, None]
        return np.minimum(albedo * ambient + self.emission, 1).astype(np.float32)

    def tilt(self, normals: np.ndarray) -> np.ndarray:
        """``[N,3]``: the part of the normals to shade by that lies in the surface, whose ``normals [N,3]`` are given;
        as long as the sine of the angle between the two."""
        along = np.einsum("nk,nk->n", self.normals, normals)
        return self.normals - along[:, None] * normals


def look(
    placed: tuple[PlacedMaps, ...],
    vertices: np.ndarray,
    faces: np.ndarray,
    face_index: np.ndarray,
    barycentric: np.ndarray,
    normals: np.ndarray,
    spacing: float = 0.0,
) -> Look:
    """What the maps make of ``barycentric [N,3]`` of the faces ``face_index [N]`` of an asset.

    Args:
        vertices: ``[V,3]``. faces: ``[F,3]``. normals: ``[N,3]`` of the part there, of unit length.
        spacing: of the points, in the unit of the vertices: finer texels of normals and occlusion are averaged.
    """
    count = len(face_index)
    shading, occlusion = np.array(normals, dtype=np.float64), np.ones(count)
    emission = np.zeros((count, 3), np.float32)
    for each in placed:
        rows = np.flatnonzero((face_index >= each.first_face) & (face_index < each.end_face))
        if len(rows) == 0:
            continue
        own = faces[each.first_face : each.end_face]
        corners, local = faces[face_index[rows]] - each.first_vertex, own - each.first_vertex
        span = vertices[each.first_vertex : each.first_vertex + local.max() + 1]
        maps, weights = each.maps, barycentric[rows]

        def at(field: np.ndarray, corners: np.ndarray = corners, weights: np.ndarray = weights) -> np.ndarray:
            return np.einsum("nk,nkc->nc", weights, field[corners])

        if maps.normal is not None:
            texture = _averaged(maps.normal, span, local, spacing)
            mapped = texture.sample_data(at(maps.normal.uv), _SIGNED) * (maps.scale, maps.scale, 1)
            if maps.tangents is not None and maps.bitangents is not None:
                frame = at(maps.tangents), at(maps.bitangents)
            else:
                along_u, up = tangents(span, local, maps.normal.placed_uv)
                rows_of = face_index[rows] - each.first_face
                right, upwards = (np.einsum("nk,nkc->nc", weights, field[rows_of]) for field in (along_u, up))
                frame = right, upwards
            shading[rows] = _tilted(shading[rows], *frame, mapped)
        if maps.occlusion is not None:
            texture = _averaged(maps.occlusion, span, local, spacing)
            occlusion[rows] = 1 + maps.strength * (texture.sample_data(at(maps.occlusion.uv), _NUMBERS)[:, 0] - 1)
        if any(maps.emission):
            picture = maps.emissive.texture.sample(at(maps.emissive.uv)) if maps.emissive else np.float32(1)
            emission[rows] = picture * np.asarray(maps.emission, np.float32)
    return Look(shading, np.clip(occlusion, 0, 1), emission)


def tangents(vertices: np.ndarray, faces: np.ndarray, uv: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit directions to the right and upwards in the picture, at the corners of each face: two ``[F,3,3]``.

    As MikkTSpace does, those of faces around a vertex are averaged by their angles, but not across a mirrored seam.

    vertices: ``[V,3]``. faces: ``[F,3]``. uv: ``[V,2]``, v downwards.
    """
    corner, place = vertices[faces], uv[faces]
    (e1, e2), (d1, d2) = ((x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]) for x in (corner, place))
    turn = np.sign(d1[:, 0] * d2[:, 1] - d2[:, 0] * d1[:, 1])[:, None]
    right = _unit(turn * (d2[:, 1:] * e1 - d1[:, 1:] * e2))
    up = _unit(-turn * (d1[:, :1] * e2 - d2[:, :1] * e1))
    ahead, back = (_unit(np.roll(corner, -k, axis=1) - corner) for k in (1, 2))
    angle = np.arccos(np.clip(np.einsum("fkc,fkc->fk", ahead, back), -1, 1)) * np.abs(turn)
    group = 2 * faces + (turn > 0)
    found: list[np.ndarray] = []
    for direction in (right, up):
        total = np.zeros((2 * len(vertices), 3))
        np.add.at(total, group, angle[..., None] * direction[:, None])
        found.append(_unit(total)[group])
    return found[0], found[1]


def glows_all_over(pixels: np.ndarray) -> bool:
    """Whether an emissive picture ``[H,W,3]`` is one of the whole object, and not of some lamps on it."""
    return bool((pixels.max(axis=-1) > _DARK).mean() > 0.5)


def is_flat(pixels: np.ndarray) -> bool:
    """Whether a normal map ``[H,W,3]`` tilts nothing."""
    return bool((_SIGNED[pixels[..., :2]] == 0).all())


def _tilted(normals: np.ndarray, right: np.ndarray, up: np.ndarray, mapped: np.ndarray) -> np.ndarray:
    """Unit ``normals [N,3]`` tilted as a normal map says, ``mapped [N,3]`` in the frame of ``right`` and ``up``."""
    tangent = right - np.einsum("nk,nk->n", right, normals)[:, None] * normals
    length = np.linalg.norm(tangent, axis=1)
    tangent = _unit(tangent)
    bitangent = np.cross(normals, tangent)
    bitangent *= np.where(np.einsum("nk,nk->n", bitangent, up) < 0, -1.0, 1.0)[:, None]
    x, y, z = mapped.T[..., None]
    tilted = _unit(x * tangent + y * bitangent + np.maximum(z, 1e-2) * normals)
    # Without a direction in the picture, or without a slope, the normal stays as it is in every bit
    moved = (length > 1e-6) & (mapped[:, :2] != 0).any(axis=1)
    return np.where(moved[:, None], tilted, normals)


def _averaged(layer: Layer, vertices: np.ndarray, faces: np.ndarray, spacing: float) -> Texture:
    """The texture with about one texel per ``spacing``, where it has more."""
    area = face_areas(vertices, faces).sum()
    place = layer.placed_uv[faces]
    (u1, v1), (u2, v2) = (place[:, 1] - place[:, 0]).T, (place[:, 2] - place[:, 0]).T
    height, width = layer.texture.pixels.shape[:2]
    texels = np.abs(u1 * v2 - u2 * v1).sum() / 2 * height * width
    return layer.texture.reduced(int(spacing * np.sqrt(texels / area)) if area > 0 and texels > 0 else 1)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-30)

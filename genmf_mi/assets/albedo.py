"""The colour of a surface: textures, factors and vertex colours, looked up as linear RGB at any point of any face."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from genmf_mi.core import colour

REPEAT, CLAMP, MIRROR = "repeat", "clamp", "mirror"


@dataclass(frozen=True, eq=False)
class Texture:
    """An sRGB-encoded image with the rules for sampling it.

    pixels: ``uint8 [H,W,3]``, row 0 at the top, which is v = 0 as in glTF.
    wrap: the rule outside of 0..1 along u and v: ``repeat``, ``clamp`` or ``mirror``.
    nearest: take the nearest texel instead of interpolating four.
    transform: ``[2,3]``, applied to (u, v, 1) before the lookup (KHR_texture_transform).
    alpha: ``uint8 [H,W]``, how opaque it is, or None for opaque all over.
    """

    pixels: np.ndarray
    wrap: tuple[str, str] = (REPEAT, REPEAT)
    nearest: bool = False
    transform: np.ndarray = field(default_factory=lambda: np.eye(2, 3))
    alpha: np.ndarray | None = None

    def opacity(self, uv: np.ndarray) -> np.ndarray:
        """0 to 1 at ``uv [N,2]``, of the nearest texel: ``[N]``."""
        if self.alpha is None:
            return np.ones(len(uv))
        uv = uv @ self.transform[:, :2].T + self.transform[:, 2]
        height, width = self.alpha.shape
        columns = _wrap(np.floor(uv[:, 0] * width).astype(np.int64), width, self.wrap[0])
        rows = _wrap(np.floor(uv[:, 1] * height).astype(np.int64), height, self.wrap[1])
        return self.alpha[rows, columns] / 255.0

    def sample(self, uv: np.ndarray) -> np.ndarray:
        """Linear RGB ``float32 [N,3]`` at ``uv [N,2]``; interpolated after decoding, as graphics cards do."""
        return self._interpolated(uv, colour.bytes_to_linear)

    def sample_data(self, uv: np.ndarray, table: np.ndarray) -> np.ndarray:
        """What a picture that holds no colours says at ``uv [N,2]``: bytes decoded by ``table [256]``, ``[N,3]``."""
        return self._interpolated(uv, table.__getitem__)

    def reduced(self, times: int) -> Texture:
        """The picture at 1/``times`` of its resolution, for data that are looked up so many texels apart."""
        from PIL import Image

        if times < 2:
            return self
        height, width = (max(1, side // times) for side in self.pixels.shape[:2])
        image = Image.fromarray(self.pixels).resize((width, height), Image.Resampling.BOX)
        return replace(self, pixels=np.asarray(image), alpha=None)

    def _interpolated(self, uv: np.ndarray, decode: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        uv = uv @ self.transform[:, :2].T + self.transform[:, 2]
        height, width = self.pixels.shape[:2]
        if self.nearest:
            columns = _wrap(np.floor(uv[:, 0] * width).astype(np.int64), width, self.wrap[0])
            rows = _wrap(np.floor(uv[:, 1] * height).astype(np.int64), height, self.wrap[1])
            return decode(self.pixels[rows, columns])
        x, y = uv[:, 0] * width - 0.5, uv[:, 1] * height - 0.5
        left, top = np.floor(x), np.floor(y)
        right_part, lower_part = (x - left).astype(np.float32)[:, None], (y - top).astype(np.float32)[:, None]
        columns = [_wrap(left.astype(np.int64) + step, width, self.wrap[0]) for step in (0, 1)]
        rows = [_wrap(top.astype(np.int64) + step, height, self.wrap[1]) for step in (0, 1)]
        texel = [[decode(self.pixels[row, column]) for column in columns] for row in rows]
        upper, lower = (left + (right - left) * right_part for left, right in texel)
        return upper + (lower - upper) * lower_part


@dataclass(frozen=True, eq=False)
class Material:
    """Base colour of some faces: ``factor`` (linear RGB) times the texture, if there is one.

    cutoff: opacity below which the faces are not seen; None where transparency is not meant. opacity: of the factor.
    name: as the file has it, empty if it has none.
    """

    factor: tuple[float, float, float] = (1.0, 1.0, 1.0)
    texture: Texture | None = None
    cutoff: float | None = None
    opacity: float = 1.0
    name: str = ""


@dataclass(frozen=True, eq=False)
class Albedo:
    """Where the colour of every face comes from: factor × texture × vertex colour, all in linear RGB.

    materials: the distinct materials.
    material: ``int64 [F]``, which of them a face has.
    uv: ``float64 [V,2]`` with v downwards; read only where the material has a texture.
    colours: linear vertex colours ``float32 [V,3]``, white where the file has none.
    """

    materials: tuple[Material, ...]
    material: np.ndarray
    uv: np.ndarray
    colours: np.ndarray

    @property
    def varies(self) -> bool:
        """Whether the colour can differ from one point to another."""
        used = [self.materials[index] for index in np.unique(self.material)]
        return (
            any(material.texture is not None for material in used)
            or len({material.factor for material in used}) > 1
            or bool(np.ptp(self.colours, axis=0).max(initial=0) > 0)
        )

    def opacity(self, faces: np.ndarray, face_index: np.ndarray, barycentric: np.ndarray) -> np.ndarray:
        """0 to 1 at ``barycentric [N,3]`` of the faces ``face_index [N]`` of ``faces [F,3]``: ``[N]``; 1 where
        transparency is not meant."""
        result = np.ones(len(face_index))
        for number, material in enumerate(self.materials):
            rows = np.flatnonzero(self.material[face_index] == number)
            if material.cutoff is None or len(rows) == 0:
                continue
            result[rows] = material.opacity
            if material.texture is not None:
                uv = np.einsum("nk,nkc->nc", barycentric[rows], self.uv[faces[face_index[rows]]])
                result[rows] *= material.texture.opacity(uv)
        return result

    def sample(self, faces: np.ndarray, face_index: np.ndarray, barycentric: np.ndarray) -> np.ndarray:
        """Linear RGB ``float32 [N,3]`` at ``barycentric [N,3]`` of the faces ``face_index [N]`` of ``faces [F,3]``."""
        corners = faces[face_index]
        rgb = np.einsum("nk,nkc->nc", barycentric.astype(np.float32), self.colours[corners])
        numbers = self.material[face_index]
        for number, material in enumerate(self.materials):
            rows = np.flatnonzero(numbers == number)
            if len(rows) == 0:
                continue
            rgb[rows] *= np.asarray(material.factor, dtype=np.float32)
            if material.texture is not None:
                uv = np.einsum("nk,nkc->nc", barycentric[rows], self.uv[corners[rows]])
                rgb[rows] *= material.texture.sample(uv)
        return np.clip(rgb, 0, 1)


def _wrap(index: np.ndarray, size: int, rule: str) -> np.ndarray:
    """Texel indices outside of the image mapped back into it."""
    if rule == CLAMP:
        return np.clip(index, 0, size - 1)
    if rule == MIRROR:
        index = index % (2 * size)
        return np.where(index < size, index, 2 * size - 1 - index)
    return index % size

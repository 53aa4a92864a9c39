"""The target: reference images of the textured object, and the teacher's depth and normal.

The reference is rendered from the *initial* surface with the object's albedo on it, under the same lights and along the
same rays as the part: an object of one colour is its own target to about 1e-6. G_gt is the HSV value of the textured
object in linear light; the lights are grey, so it is max(R, G, B) of the linear albedo times the shading. Where a file
has a normal map, the object is shaded by the normals that it pretends, baked into the vertex normals of the reference,
as the albedo is baked: the part is another mesh than that of the file and has no texture coordinates, which Mitsuba's
BSDF ``normalmap`` would need.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Float32, Int
from numpy import ndarray
from PIL import Image, UnidentifiedImageError
from skimage import transform

from genmf_mi.assets.maps import Look
from genmf_mi.assets.part import open_image
from genmf_mi.assets.reading import LARGEST_PIXELS
from genmf_mi.core.colour import to_linear, value
from genmf_mi.core.errors import AssetError, ConfigError
from genmf_mi.render import bridge
from genmf_mi.render import scene as scenes
from genmf_mi.render.scene import RenderSettings, Scene, View

_transform: Any = transform  # its annotations are incomplete

ALBEDO, RED, GREEN, BLUE = "vertex_albedo", "vertex_red", "vertex_green", "vertex_blue"
OCCLUSION, EMISSION = "vertex_occlusion", {RED: "vertex_redglow", GREEN: "vertex_greenglow", BLUE: "vertex_blueglow"}
FILE = "reference.ply"
MOST_PIXELS = 2048
"""Per side of a reference image; larger ones are scaled down."""
FINEST = 700_000
"""The reference mesh is the part's mesh with every triangle split into four as often as this many faces allow, so that
it resolves the texture more finely than the part itself."""

Albedo = Callable[[ndarray, ndarray], ndarray]
"""From points and normals ``[N,3]`` in the normalised frame to linear RGB ``[N,3]``."""
MapLook = Callable[[ndarray, ndarray, float], Look | None]
"""From points and normals ``[N,3]`` in the normalised frame and the distance between points to what the maps make of
them, None without maps."""


@dataclass(frozen=True)
class Picture:
    """A given image of the object, to be matched instead of its texture.

    view: where its camera stood. rgba: ``[h,w,4]`` linear RGB and coverage, 0..1.
    """

    view: View
    rgba: Float32[ndarray, "h w 4"]

    def fitted(self, mask: Float[ndarray, "H W"]) -> Float32[ndarray, "H W 4"]:
        """``[H,W,4]``: the picture moved and scaled so that its outline fills the bounding box of ``mask [H,W]``; its
        colour is multiplied by its coverage."""
        (top, bottom), (left, right) = _extent(mask), _extent(mask.T)
        rows, columns = (slice(*_extent(a)) for a in (self.rgba[..., 3], self.rgba[..., 3].T))
        fitted = np.zeros((*mask.shape, 4), np.float32)
        cut = self.rgba[rows, columns].copy()
        cut[..., :3] *= cut[..., 3:]
        size = (bottom - top, right - left, 4)
        fitted[top:bottom, left:right] = _transform.resize(cut, size, order=1, anti_aliasing=True)
        return fitted


@dataclass
class Reference:
    """The textured object, which can be rendered from any view.

    scene: around the subdivided initial mesh with its albedo as a vertex attribute.
    pictures: given images; from their views they replace the textured object.
    emissive: whether it gives off light of its own: its brightest channel then depends on how it is lit.
    """

    scene: Scene
    pictures: tuple[Picture, ...] = ()
    emissive: bool = False

    @property
    def views(self) -> tuple[View, ...]:
        """The views of the pictures, or else the scene's own."""
        return tuple(p.view for p in self.pictures) or self.scene.views

    def render(self, views: Sequence[View], seed: int = 0, samples: int = 0) -> bridge.Buffers:
        """G_gt in ``grey``, D_t in ``depth``, N_t in ``normal``, the mask in ``coverage``; see
        :class:`bridge.Buffers`."""
        if self.emissive:
            shown = [self._shown(channel, views, seed, samples) for channel in (RED, GREEN, BLUE)]
            brightest = torch.stack([each.grey for each in shown]).amax(dim=0)
            buffers = replace(shown[0], grey=brightest)
        else:
            buffers = bridge.render(self.scene, views, seed=seed, samples=samples)
        _, _, coverage = buffers.geometry
        for i, fitted in self._fitted(views, buffers):
            buffers.grey[i, 0] = torch.as_tensor(value(fitted[..., :3])).to(buffers.grey)
            coverage[i, 0] = torch.as_tensor(fitted[..., 3]).to(coverage)
        return buffers

    def render_colour(self, views: Sequence[View], seed: int = 0, samples: int = 0) -> Float32[ndarray, "B H W 3"]:
        """``[B,H,W,3]`` linear RGB of the textured object under the two lights."""
        shown = [self._shown(channel, views, seed, samples).grey for channel in (RED, GREEN, BLUE)]
        image = np.stack([grey[:, 0].cpu().numpy() for grey in shown], axis=-1)
        if self.pictures:
            for i, fitted in self._fitted(views, bridge.render(self.scene, views, seed=seed, samples=samples)):
                image[i] = fitted[..., :3]
        return image

    def _fitted(
        self, views: Sequence[View], buffers: bridge.Buffers
    ) -> Iterator[tuple[int, Float32[ndarray, "H W 4"]]]:
        """Index and fitted image of those views that have a picture, 0 outside of the outline of either."""
        _, _, masks = buffers.geometry
        for i, view in enumerate(views):
            for picture in self.pictures:
                if picture.view == view:
                    coverage = masks[i, 0].cpu().numpy()
                    yield i, picture.fitted(coverage) * coverage[..., None]

    def _shown(self, channel: str, views: Sequence[View], seed: int, samples: int) -> bridge.Buffers:
        """One of the colours of the object."""
        bsdf = self.scene.bsdf
        before = bsdf.attribute, bsdf.emission
        bsdf.attribute, bsdf.emission = channel, EMISSION[channel] if self.emissive else ""
        try:
            return bridge.render(self.scene, views, seed=seed, samples=samples)
        finally:
            bsdf.attribute, bsdf.emission = before


def read_picture(text: str) -> Picture:
    """``image.png@azimuth,elevation`` to a picture; without transparency the colour of its corners is the background.

    Raises:
        ConfigError: not of that form. AssetError: no readable image, or nothing in it.
    """
    path, _, angles = text.rpartition("@")
    try:
        view = View.parse(angles, ",")
    except ValueError as error:
        raise ConfigError(f"write a reference as image.png@azimuth,elevation in degrees, not {text!r}.") from error
    pixels = _decoded(path)
    coverage = pixels[..., 3]
    if coverage.min() > 0.99:
        corners = pixels[[0, 0, -1, -1], [0, -1, 0, -1], :3]
        coverage = (np.abs(pixels[..., :3] - np.median(corners, axis=0)).max(axis=-1) > 0.05).astype(np.float32)
    if (coverage > 0.5).sum() < 16:
        raise AssetError(
            f"the reference image {path} is empty: everything in it is transparent or of the background's colour."
        )
    return Picture(view, np.concatenate([to_linear(pixels[..., :3]).astype(np.float32), coverage[..., None]], axis=-1))


def _decoded(path: str) -> Float32[ndarray, "h w 4"]:
    """RGBA, 0..1, of at most :data:`MOST_PIXELS` per side. Raises :class:`AssetError`."""
    try:
        if os.path.exists(path) and not os.path.isfile(path):
            raise AssetError(f"cannot read the reference image {path}: it is no file. Give a PNG or JPEG.")
        with open(path, "rb") as file, open_image(file) as image:
            if image.width * image.height > LARGEST_PIXELS:
                raise AssetError(
                    f"the reference image {path} has {image.width} × {image.height} pixels. Scale it down to "
                    f"{MOST_PIXELS} × {MOST_PIXELS}."
                )
            shrink = -(-max(image.size) // MOST_PIXELS)
            picture = image.convert("RGBA")
            if shrink > 1:
                picture = picture.convert("RGBa").reduce(shrink).convert("RGBA")
            return np.asarray(picture, dtype=np.float32) / np.float32(255)
    except Image.DecompressionBombError:
        raise AssetError(
            f"the reference image {path} has too many pixels. Scale it down to {MOST_PIXELS} × {MOST_PIXELS}."
        ) from None
    except (OSError, UnidentifiedImageError, SyntaxError, ValueError, EOFError, struct.error) as error:
        raise AssetError(f"cannot read the reference image {path}: {error}.") from error


def _extent(mask: Float[ndarray, "R C"]) -> tuple[int, int]:
    """First and one past the last row in which the mask is more than half full."""
    rows = np.flatnonzero((mask > 0.5).any(axis=1))
    return int(rows[0]), int(rows[-1]) + 1


def subdivide(faces: Int[ndarray, "F 3"], *fields: Float[ndarray, "V ..."]) -> tuple[ndarray, ...]:
    """Split every triangle into four at its edge midpoints: the new faces ``[4F,3]``, then every field ``[V,...]`` on
    the old and the new vertices."""
    count = len(fields[0])
    edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    keys, inverse = np.unique(edges[:, 0] * np.int64(count) + edges[:, 1], return_inverse=True)
    ends = np.stack([keys // count, keys % count], axis=1)
    (a, b, c), (ab, bc, ca) = faces.T, (count + inverse.reshape(-1, 3)).T
    split = np.concatenate([np.stack(t, axis=1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
    return split, *(np.concatenate([x, x[ends].mean(axis=1)]) for x in fields)


def subdivided(faces: Int[ndarray, "F 3"], *fields: Float[ndarray, "V ..."]) -> tuple[ndarray, ...]:
    """Faces ``[G,3]`` and fields of the mesh of the reference, from those of the part."""
    mesh = faces, *fields
    while 4 * len(mesh[0]) <= FINEST:
        mesh = subdivide(*mesh)
    return mesh


def build_reference(
    xml: Path,
    folder: Path,
    vertices: Float[ndarray, "V 3"],
    faces: Int[ndarray, "F 3"],
    normals: Float[ndarray, "V 3"],
    albedo: Albedo,
    settings: RenderSettings,
    pictures: tuple[Picture, ...] = (),
    look: MapLook | None = None,
) -> Reference:
    """Write the mesh of the reference to ``folder`` and load it.

    xml: the scene file. vertices, normals: of the initial mesh, ``[V,3]`` in the normalised frame, as the part is
    rendered before refinement; faces ``[F,3]``. pictures: see :class:`Reference`. look: of the maps of the file.

    Raises:
        OutputError: the mesh cannot be written.
        SceneError: as :func:`genmf_mi.render.scene.load`.
    """
    faces, vertices, normals = subdivided(faces, vertices, normals)
    rgb = albedo(vertices, normals)
    attributes = {ALBEDO: value(rgb), RED: rgb[:, 0], GREEN: rgb[:, 1], BLUE: rgb[:, 2]}
    spacing = float(np.linalg.norm(vertices[faces[:, 0]] - vertices[faces[:, 1]], axis=1).mean())
    unit = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    seen = look(vertices, unit, spacing) if look else None
    if seen is not None:
        normals = np.where((seen.normals != unit).any(axis=1, keepdims=True), seen.normals, normals)
        if (seen.occlusion < 1).any():
            attributes[OCCLUSION] = seen.occlusion
        if seen.emission.any():
            attributes |= {name: seen.emission[:, i] for i, name in enumerate(EMISSION.values())}
    bridge.write_ply(folder / FILE, vertices, faces, normals=normals, attributes=attributes)
    return load_reference(xml, folder, settings, pictures)


def load_reference(xml: Path, folder: Path, settings: RenderSettings, pictures: tuple[Picture, ...] = ()) -> Reference:
    """The reference whose mesh :func:`build_reference` wrote to ``folder``, at another resolution.

    Raises:
        SceneError: as :func:`genmf_mi.render.scene.load`.
    """
    scene = scenes.load(xml, folder / FILE, **asdict(settings), attribute=ALBEDO)
    if scene.has_attribute(OCCLUSION):
        scene.bsdf.occlusion = OCCLUSION
    return Reference(scene, pictures, emissive=scene.has_attribute(EMISSION[RED]))

"""3MF with its colours, through lib3mf, the consortium's own library; trimesh reads the geometry only."""

from __future__ import annotations

import re
import shutil
import tempfile
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from genmf_mi.assets.albedo import CLAMP, MIRROR, REPEAT, Material, Texture
from genmf_mi.assets.part import Part, decode_image
from genmf_mi.core import colour
from genmf_mi.core.errors import AssetError
from genmf_mi.core.text import printable

MOST_PARTS = 2000
"""Objects on the build plate, components counted each time that they are used."""
_OBJECT = re.compile(rb'<(?:\w+:)?object\b[^>]*?\bid="(\d+)"(.*?)</(?:\w+:)?object>', re.DOTALL)
_COMPONENT = re.compile(rb'<(?:\w+:)?component\b[^>]*?\bobjectid="(\d+)"')
LARGEST_MODEL = 512 * 1024**2
"""Bytes of a file in the archive that is searched."""


def read(path: Path) -> list[Part]:
    """All objects on the build plate, in the file's own unit and z up, one part per object and property group.

    Colours are sRGB-encoded by the specification; of composite materials the display colours are mixed in linear light.

    Raises:
        AssetError: the file uses multi-properties, which layer several colours on one triangle; it has parts that a
            slicer would subtract; its only colours are painted in a slicer; or it repeats its components without end.
    """
    from lib3mf import get_wrapper

    _require_understood(path)
    _require_bounded(path)
    model: Any = get_wrapper().CreateModel()  # the generated bindings declare that it may be None
    with tempfile.TemporaryDirectory(prefix="genmf-") as folder:
        # lib3mf takes names that are UTF-8 only
        named = path if printable(str(path)) == str(path) else Path(shutil.copy(path, Path(folder) / "asset.3mf"))
        model.QueryReader("3mf").ReadFromFile(str(named))
    parts, groups = [], {}
    items = model.GetBuildItems()
    while items.MoveNext():
        item = items.GetCurrent()
        matrix = _matrix(item.GetObjectTransform()) if item.HasObjectTransform() else np.eye(4)
        parts += _object(path, model, groups, item.GetObjectResource(), matrix)
    coloured = any(part.material.texture is not None or part.colours is not None for part in parts)
    if not coloured and (painter := _painted(path)):
        raise AssetError(
            f"{path} has its colours painted in {painter}, which are kept in a way of its own. Put them into a texture "
            "or vertex colours, and export it as GLB, OBJ or PLY."
        )
    return parts


def _require_understood(path: Path) -> None:
    """Raise :class:`AssetError` for what slicers write into their own files of settings and would change the shape."""
    settings = _member(path, "Metadata/model_settings.config", "Metadata/Slic3r_PE_model.config")
    if re.search(rb'subtype="negative_part"|key="volume_type" value="NegativeVolume"', settings):
        raise AssetError(
            f"{path} has negative parts, which a slicer cuts out of the others. Cut them there, and export it again."
        )


def _require_bounded(path: Path) -> None:
    """Raise :class:`AssetError` for more than :data:`MOST_PARTS`, before lib3mf expands them all: components that refer
    to components can double some dozen times in a few kilobytes."""
    held: dict[str, list[str]] = {}
    for text in _models(path):
        for number, body in _OBJECT.findall(text):
            held.setdefault(number.decode(), []).extend(inner.decode() for inner in _COMPONENT.findall(body))
    counts: dict[str, int] = {}

    def count(number: str, above: tuple[str, ...]) -> int:
        if number in above:
            raise AssetError(f"{path} has an object that contains itself. Export it again.")
        if number not in counts:
            inner = held.get(number, [])
            counts[number] = sum(count(one, (*above, number)) for one in inner) if inner else 1
        return counts[number]

    if max((count(number, ()) for number in held), default=0) > MOST_PARTS:
        raise AssetError(f"{path} has more than {MOST_PARTS} parts. Merge them, and export it again.")


def _models(path: Path) -> Iterator[bytes]:
    """The model files in the archive, each up to :data:`LARGEST_MODEL`."""
    with zipfile.ZipFile(path) as archive:
        for name in archive.namelist():
            if name.lower().endswith(".model"):
                with archive.open(name) as stream:
                    yield stream.read(LARGEST_MODEL)


def _painted(path: Path) -> str:
    """The program in which the triangles of a file were painted; empty if they were not."""
    for text in _models(path):
        if re.search(rb'\bpaint_color="', text):
            return "Bambu Studio or OrcaSlicer"
        if re.search(rb'mmu_segmentation="', text):
            return "PrusaSlicer"
    return ""


def _member(path: Path, *names: str) -> bytes:
    """The first of these files in the archive, up to :data:`LARGEST_MODEL`; empty if there is none."""
    try:
        with zipfile.ZipFile(path) as archive:
            for name in names:
                if name in archive.namelist():
                    with archive.open(name) as stream:
                        return stream.read(LARGEST_MODEL)
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError, OSError):
        raise AssetError(
            f"{path} cannot be read as 3MF: it is no archive, or a damaged one. Download or export it again."
        ) from None
    return b""


def _object(path: Path, model, groups: dict, item, matrix: np.ndarray) -> list[Part]:
    if item.IsComponentsObject():
        parts, assembly = [], model.GetComponentsObjectByID(item.GetUniqueResourceID())
        for index in range(assembly.GetComponentCount()):
            component = assembly.GetComponent(index)
            inner = _matrix(component.GetTransform()) if component.HasTransform() else np.eye(4)
            parts += _object(path, model, groups, component.GetObjectResource(), matrix @ inner)
        return parts
    mesh = model.GetMeshObjectByID(item.GetUniqueResourceID())
    vertices = np.array([tuple(vertex.Coordinates) for vertex in mesh.GetVertices()], dtype=np.float64).reshape(-1, 3)
    faces = np.array([tuple(face.Indices) for face in mesh.GetTriangleIndices()], dtype=np.int64).reshape(-1, 3)
    fallback, number, present = mesh.GetObjectLevelProperty()
    group, corner = np.zeros(len(faces), dtype=np.int64), np.zeros((len(faces), 3), dtype=np.int64)
    if present:
        group[:], corner[:] = fallback, number
    for row, properties in enumerate(mesh.GetAllTriangleProperties()):
        if properties.ResourceID:
            group[row], corner[row] = properties.ResourceID, tuple(properties.PropertyIDs)
    parts = []
    name = str(item.GetName())
    for identifier in np.unique(group):
        rows = group == identifier
        if identifier not in groups:
            groups[identifier] = _group(path, model, int(identifier))
        material, uv, colours = groups[identifier]
        ids = corner[rows].ravel()
        parts.append(
            Part(
                vertices[faces[rows]].reshape(-1, 3),
                np.arange(3 * rows.sum()).reshape(-1, 3),
                material,
                None if uv is None else np.array([uv[number] for number in ids]),
                None if colours is None else np.array([colours[number] for number in ids], dtype=np.float32),
                names=((name,) if name else (),),
            ).transformed(matrix)
        )
    return parts


def _group(path: Path, model, identifier: int) -> tuple[Material, dict | None, dict | None]:
    """A group of properties: its material, and texture coordinates or linear colours by property number."""
    from lib3mf import PropertyType, TextureFilter

    if identifier == 0:
        return Material(), None, None
    kind = model.GetPropertyTypeByID(identifier)
    if kind == PropertyType.Colors:
        group = model.GetColorGroupByID(identifier)
        return Material(), None, {number: _linear(group.GetColor(number)) for number in group.GetAllPropertyIDs()}
    if kind == PropertyType.BaseMaterial:
        return Material(), None, _base_colours(model.GetBaseMaterialGroupByID(identifier))
    if kind == PropertyType.Composite:
        group = model.GetCompositeMaterialsByID(identifier)
        base, colours = _base_colours(group.GetBaseMaterialGroup()), {}
        for number in group.GetAllPropertyIDs():
            shares = group.GetComposite(number)
            total = sum(share.MixingRatio for share in shares) or 1.0
            colours[number] = sum(base[share.PropertyID] * (share.MixingRatio / total) for share in shares)
        return Material(), None, colours
    if kind == PropertyType.TexCoord:
        group = model.GetTexture2DGroupByID(identifier)
        image = group.GetTexture2D()
        attachment = image.GetAttachment()
        along_u, along_v = (_WRAP[int(style)] for style in image.GetTileStyleUV())
        texture = Texture(
            decode_image(bytes(attachment.WriteToBuffer()), attachment.GetPath()),
            (along_u, along_v),
            image.GetFilter() == TextureFilter.Nearest,
        )
        uv = {}
        for number in group.GetAllPropertyIDs():
            at = group.GetTex2Coord(number)
            uv[number] = (at.U, 1 - at.V)  # v points up in 3MF
        return Material(texture=texture), uv, None
    raise AssetError(f"{path} layers several colours on one triangle (multi-properties). Export it as GLB instead.")


def _base_colours(group) -> dict[int, np.ndarray]:
    return {number: _linear(group.GetDisplayColor(number)) for number in group.GetAllPropertyIDs()}


def _linear(rgba) -> np.ndarray:
    return colour.bytes_to_linear(np.array([rgba.Red, rgba.Green, rgba.Blue]))


def _matrix(transform) -> np.ndarray:
    """A 3MF transform, whose rows are the images of the axes and the origin, as ``[4,4]`` for column vectors."""
    matrix = np.eye(4)
    matrix[:3] = np.array([tuple(row) for row in transform.Fields]).T
    return matrix


_WRAP = {0: REPEAT, 1: MIRROR, 2: CLAMP, 3: CLAMP}
"""lib3mf's TextureTileStyle; outside a texture that is not tiled the specification leaves the colour open."""

"""An asset as the page draws it: GLB with the textures as they are, whatever file it came from."""

from __future__ import annotations

import io
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from genmf_mi.assets.albedo import CLAMP, MIRROR, Material
from genmf_mi.assets.asset import Asset
from genmf_mi.core.files import atomic

LARGEST_TEXTURE = 4096
"""Pixels a side; larger textures are reduced."""
_WRAP = {CLAMP: 33071, MIRROR: 33648}


def write_model(path: Path, asset: Asset) -> None:
    """Write positions, texture coordinates, colours and materials; one primitive per material."""
    builder = _Glb()
    used, albedo = [], asset.albedo
    textured = any(material.texture is not None for material in albedo.materials)
    attributes = {"POSITION": builder.array(asset.vertices.astype("<f4"), "VEC3", 34962)}
    if np.ptp(albedo.colours, axis=0).max(initial=0) > 0 or (albedo.colours.size and albedo.colours.min() < 1):
        colours = np.column_stack([np.clip(albedo.colours, 0, 1), np.ones(len(albedo.colours))])
        attributes["COLOR_0"] = builder.array(np.rint(colours * 65535).astype("<u2"), "VEC4", 34962, normalized=True)
    for number in np.unique(albedo.material):
        material = albedo.materials[number]
        faces = asset.faces[albedo.material == number]
        of_this = dict(attributes)
        if textured and material.texture is not None:
            turn = material.texture.transform
            uv = albedo.uv @ turn[:, :2].T + turn[:, 2]
            of_this["TEXCOORD_0"] = builder.array(uv.astype("<f4"), "VEC2", 34962)
        indices = builder.array(faces.astype("<u4").reshape(-1), "SCALAR", 34963)
        used.append({"attributes": of_this, "indices": indices, "material": builder.material(material)})
    builder.tree["meshes"] = [{"primitives": used}]
    with atomic(path) as temporary:
        builder.write(temporary)


class _Glb:
    """Collects the buffer and the JSON of a GLB."""

    def __init__(self) -> None:
        self._chunks: list[bytes] = []
        self._size = 0
        self.tree: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": "genmf_mi"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0}],
            "accessors": [],
            "bufferViews": [],
            "materials": [],
        }

    def array(self, values: np.ndarray, kind: str, target: int, normalized: bool = False) -> int:
        """The number of the accessor of an array."""
        view = self._view(values.tobytes(), target)
        types = {"<f4": 5126, "<u4": 5125, "<u2": 5123}
        accessor = {
            "bufferView": view, "componentType": types[values.dtype.str], "count": len(values), "type": kind,
        }  # fmt: skip
        if kind == "VEC3":
            accessor |= {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()}
        if normalized:
            accessor["normalized"] = True
        self.tree["accessors"].append(accessor)
        return len(self.tree["accessors"]) - 1

    def material(self, material: Material) -> int:
        """The number of a material."""
        surface: dict[str, Any] = {"baseColorFactor": [*map(float, material.factor), material.opacity]}
        if material.texture is not None:
            surface["baseColorTexture"] = {"index": self._texture(material)}
        entry: dict[str, Any] = {"pbrMetallicRoughness": surface}
        if material.cutoff is not None:
            entry |= {"alphaMode": "MASK", "alphaCutoff": float(material.cutoff)}
        self.tree["materials"].append(entry)
        return len(self.tree["materials"]) - 1

    def write(self, path: Path) -> None:
        """Write the file."""
        self.tree["buffers"] = [{"byteLength": self._size}]
        text = json.dumps(self.tree).encode()
        text += b" " * (-len(text) % 4)
        with path.open("wb") as file:
            file.write(struct.pack("<4sII", b"glTF", 2, 12 + 8 + len(text) + 8 + self._size))
            file.write(struct.pack("<I4s", len(text), b"JSON") + text)
            file.write(struct.pack("<I4s", self._size, b"BIN\0"))
            file.writelines(self._chunks)

    def _texture(self, material: Material) -> int:
        texture = material.texture
        assert texture is not None
        channels = [texture.pixels] if texture.alpha is None else [texture.pixels, texture.alpha[..., None]]
        image = Image.fromarray(np.concatenate(channels, axis=2))
        if max(image.size) > LARGEST_TEXTURE:
            image.thumbnail((LARGEST_TEXTURE, LARGEST_TEXTURE))
        buffer = io.BytesIO()
        image.save(buffer, "PNG", compress_level=1)
        for name in ("images", "samplers", "textures"):
            self.tree.setdefault(name, [])
        self.tree["images"].append({"bufferView": self._view(buffer.getvalue()), "mimeType": "image/png"})
        wrap = [_WRAP.get(rule, 10497) for rule in texture.wrap]
        sampler: dict[str, Any] = {"wrapS": wrap[0], "wrapT": wrap[1]}
        if texture.nearest:
            sampler["magFilter"] = 9728
        self.tree["samplers"].append(sampler)
        number = len(self.tree["textures"])
        self.tree["textures"].append({"source": len(self.tree["images"]) - 1, "sampler": number})
        return number

    def _view(self, data: bytes, target: int | None = None) -> int:
        view: dict[str, Any] = {"buffer": 0, "byteOffset": self._size, "byteLength": len(data)}
        if target:
            view["target"] = target
        self.tree["bufferViews"].append(view)
        padded = data + b"\0" * (-len(data) % 4)
        self._chunks.append(padded)
        self._size += len(padded)
        return len(self.tree["bufferViews"]) - 1

"""glTF files built by hand, accessor by accessor, for what exporters rarely write."""

from __future__ import annotations

import io
import json
import struct
from pathlib import Path

import numpy as np
from PIL import Image

_COMPONENT = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
_TYPE = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


class Gltf:
    """A document that grows: ``accessor`` and ``image`` return indices; ``tree`` is free to edit before ``glb``."""

    def __init__(self) -> None:
        self.tree = {"asset": {"version": "2.0"}, "accessors": [], "bufferViews": []}
        self.binary = b""

    def view(self, data: bytes, **extra) -> int:
        self.binary += b"\0" * (-len(self.binary) % 4)
        self.tree["bufferViews"].append({"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(data), **extra})
        self.binary += data
        return len(self.tree["bufferViews"]) - 1

    def accessor(self, array: np.ndarray, normalized: bool = False, **extra) -> int:
        array = np.asarray(array)
        array = array.reshape(len(array), -1)
        entry = {
            "bufferView": self.view(array.tobytes()),
            "componentType": _COMPONENT[array.dtype.str[1:]],
            "count": len(array),
            "type": _TYPE[array.shape[1]],
            **({"normalized": True} if normalized else {}),
            **extra,
        }
        self.tree["accessors"].append(entry)
        return len(self.tree["accessors"]) - 1

    def image(self, pixels: np.ndarray) -> int:
        stream = io.BytesIO()
        Image.fromarray(pixels).save(stream, "PNG")
        images = self.tree.setdefault("images", [])
        images.append({"bufferView": self.view(stream.getvalue()), "mimeType": "image/png"})
        return len(images) - 1

    def mesh(self, *primitives: dict, nodes: list[dict] | None = None) -> Gltf:
        self.tree |= {
            "meshes": [{"primitives": list(primitives)}],
            "nodes": nodes or [{"mesh": 0}],
            "scenes": [{"nodes": [0]}],
            "scene": 0,
        }
        return self

    def glb(self, path: Path) -> Path:
        self.tree["buffers"] = [{"byteLength": len(self.binary)}]
        text = json.dumps(self.tree).encode()
        text += b" " * (-len(text) % 4)
        binary = self.binary + b"\0" * (-len(self.binary) % 4)
        size = 12 + 8 + len(text) + 8 + len(binary)
        path.write_bytes(
            struct.pack("<4sII", b"glTF", 2, size)
            + struct.pack("<I4s", len(text), b"JSON")
            + text
            + struct.pack("<I4s", len(binary), b"BIN\0")
            + binary
        )
        return path


QUAD = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=np.float32)
QUAD_FACES = np.array([0, 1, 2, 0, 2, 3], dtype=np.uint16)


def textured_quad(
    path: Path,
    pixels: np.ndarray,
    uv: np.ndarray,
    *,
    sampler: dict | None = None,
    factor: list[float] | None = None,
    transform: dict | None = None,
    colours: np.ndarray | None = None,
    uv_set: int = 0,
) -> Path:
    """A GLB with one unit square in the plane z = 0 and a base-colour texture."""
    gltf = Gltf()
    attributes = {"POSITION": gltf.accessor(QUAD), f"TEXCOORD_{uv_set}": gltf.accessor(np.asarray(uv, np.float32))}
    if uv_set:
        attributes["TEXCOORD_0"] = gltf.accessor(np.zeros((4, 2), np.float32))
    if colours is not None:
        attributes["COLOR_0"] = gltf.accessor(colours, normalized=colours.dtype.kind == "u")
    picture = {"index": 0, "texCoord": uv_set}
    if transform:
        picture["extensions"] = {"KHR_texture_transform": transform}
        gltf.tree["extensionsRequired"] = ["KHR_texture_transform"]
    surface = {"baseColorTexture": picture, **({"baseColorFactor": factor} if factor else {})}
    gltf.tree |= {
        "materials": [{"pbrMetallicRoughness": surface}],
        "textures": [{"source": gltf.image(pixels), **({"sampler": 0} if sampler else {})}],
        "samplers": [sampler or {}],
    }
    return gltf.mesh({"attributes": attributes, "indices": gltf.accessor(QUAD_FACES), "material": 0}).glb(path)

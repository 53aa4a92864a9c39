"""The data of a glTF file: its JSON tree, and the bytes and arrays in its buffers."""

from __future__ import annotations

import base64
import json
import struct
from functools import cached_property
from importlib import import_module
from pathlib import Path
from urllib.parse import unquote

import numpy as np

from genmf_mi.assets.formats import beside
from genmf_mi.core.errors import AssetError

_DTYPE = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
LARGEST_COUNT = 50_000_000
"""Entries of an array."""
_WIDTH = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}


class GltfData:
    """The JSON tree of a ``.glb`` or ``.gltf`` file, and access to its buffers.

    Raises:
        AssetError: the file is truncated, not glTF 2.0, or refers to a file that is missing.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.tree, self._binary = _container(path)
        self._buffers: dict[int, bytes] = {}

    def accessor(self, index: int) -> np.ndarray:
        """An accessor as ``[count, width]``: floats, or integers as stored; normalised integers become floats
        (3.6.2)."""
        accessor = self.tree["accessors"][index]
        dtype, width = np.dtype(_DTYPE[accessor["componentType"]]), _WIDTH[accessor["type"]]
        count = self._whole(accessor["count"], LARGEST_COUNT)
        if "bufferView" in accessor:
            view = self.tree["bufferViews"][accessor["bufferView"]]
            data = self.view(accessor["bufferView"])
            packed = dtype.itemsize * width
            stride, start = self._whole(view.get("byteStride") or packed, 252), accessor.get("byteOffset", 0)
            if count and self._whole(start, len(data)) + (count - 1) * stride + packed > len(data):
                raise AssetError(f"{self.path} is damaged: an array reaches beyond its data. Export it again.")
            array = np.ndarray((count, width), dtype, data, start, (stride, dtype.itemsize))
        else:
            self._whole(count, self._stored)
            array = np.zeros((count, width), dtype)
        if "sparse" in accessor:
            sparse, array = accessor["sparse"], array.copy()
            where, what = sparse["indices"], sparse["values"]
            size, kind = self._whole(sparse["count"], count), _DTYPE[where["componentType"]]
            rows = np.frombuffer(self.view(where["bufferView"]), kind, size, where.get("byteOffset", 0))
            values = np.frombuffer(self.view(what["bufferView"]), dtype, size * width, what.get("byteOffset", 0))
            array[rows] = values.reshape(-1, width)
        if accessor.get("normalized") and dtype.kind in "iu":
            return np.maximum(array / np.float32(np.iinfo(dtype).max), -1)
        return array

    @cached_property
    def _stored(self) -> int:
        """The most entries of an array that has its data in a file; one that has none is as long as another."""
        counts = [entry.get("count") for entry in self.tree["accessors"] if "bufferView" in entry]
        return max((count for count in counts if isinstance(count, int)), default=0)

    def draco(self, primitive: dict) -> dict[int, np.ndarray]:
        """The compressed accessors of a primitive, by accessor index."""
        try:
            DracoPy = import_module("DracoPy")  # an optional dependency
        except ImportError:
            raise AssetError(
                f"{self.path} is Draco-compressed. Run `pip install DracoPy`, or export it without compression."
            ) from None
        extension = primitive["extensions"]["KHR_draco_mesh_compression"]
        mesh = DracoPy.decode(bytes(self.view(extension["bufferView"])))
        decoded = {primitive["indices"]: np.asarray(mesh.faces)}
        for name, identifier in extension["attributes"].items():
            index = primitive["attributes"][name]
            array = np.asarray(mesh.get_attribute_by_unique_id(identifier)["data"])
            if self.tree["accessors"][index].get("normalized") and array.dtype.kind in "iu":
                array = array / np.float32(np.iinfo(array.dtype).max)
            decoded[index] = array
        return decoded

    def view(self, index: int) -> memoryview:
        """The bytes of a buffer view (3.6.1)."""
        view = self.tree["bufferViews"][index]
        buffer = self.buffer(view["buffer"])
        start, length = view.get("byteOffset", 0), self._whole(view["byteLength"], max(len(buffer), LARGEST_COUNT))
        data = memoryview(buffer)[self._whole(start, max(len(buffer), LARGEST_COUNT)) :][:length]
        if len(data) < length:
            raise AssetError(f"{self.path} is truncated: its data ends early. Download or export it again.")
        return data

    def buffer(self, index: int) -> bytes:
        """The bytes of a buffer, which is read once."""
        if index not in self._buffers:
            uri = self.tree["buffers"][index].get("uri")
            self._buffers[index] = self._binary if uri is None else self.resource(uri)
        return self._buffers[index]

    def resource(self, uri: str) -> bytes:
        """The bytes behind a data URI or the name of a file beside the asset (2.8)."""
        if uri.startswith("data:"):
            return base64.b64decode(uri.partition(",")[2])
        data = beside.read(self.path, unquote(uri, errors="surrogateescape"))
        if data is None:
            raise AssetError(
                f"{self.path} refers to {uri}, which is not beside it. "
                "Put that file there, or export a self-contained GLB."
            )
        return data

    def _whole(self, number: object, largest: int) -> int:
        """``number`` if it is a whole one from 0 to ``largest``."""
        if not (isinstance(number, int) and 0 <= number <= largest):
            raise AssetError(f"{self.path} is damaged: it asks for {number} of something. Export it again.")
        return number


def _container(path: Path) -> tuple[dict, bytes]:
    """The JSON tree and the binary chunk of a file (4.4)."""
    data, binary = path.read_bytes(), b""
    if data[:4] == b"glTF":
        if len(data) < 20 or len(data) < struct.unpack_from("<I", data, 8)[0]:
            raise AssetError(f"{path} is truncated at {len(data)} bytes. Download or export it again.")
        version, _, size = struct.unpack_from("<III", data, 4)
        text, offset = data[20 : 20 + size], 20 + size
        while offset + 8 <= len(data):
            size, kind = struct.unpack_from("<I4s", data, offset)
            if kind == b"BIN\0":
                binary = data[offset + 8 : offset + 8 + size]
                break
            offset += 8 + size
    else:
        text, version = data, 2
    try:
        # Names that are no UTF-8 must not cost the file
        tree = json.loads(text.decode(json.detect_encoding(text), "surrogateescape"))
        version = min(version, int(tree["asset"]["version"].split(".")[0]))
    except (ValueError, KeyError, TypeError, AttributeError):
        raise AssetError(f"{path} is not glTF. Check that the download is complete.") from None
    if version < 2:
        raise AssetError(f"{path} is glTF 1, which is obsolete. Export it as glTF 2.0.")
    return tree, binary

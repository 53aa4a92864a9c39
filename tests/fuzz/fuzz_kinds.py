"""Damage to files of each kind: what a writer of that kind would never write."""

from __future__ import annotations

import io
import json
import struct
import zipfile
import zlib
from typing import Any

import numpy as np
import torch
from fuzz_edits import (
    ARRAYS,
    NAMES,
    NUMBERS,
    VALUES,
    Draw,
    damaged,
    edited_lines,
    edited_tree,
    edited_xml,
    json_bytes,
)  # fmt: skip
from fuzz_seeds import Case, fields, torch_file
from hypothesis import strategies as st
from safetensors.numpy import save


def bytes_of_any(draw: Draw, case: Case) -> Case:
    name = draw(st.sampled_from(sorted(case.files)))
    return case.with_file(name, damaged(draw, case.files[name]))


def glb(draw: Draw, case: Case) -> Case:
    data = case.files[case.main]
    try:
        size = struct.unpack_from("<I", data, 12)[0]
        tree, binary = json.loads(data[20 : 20 + size]), data[28 + size :]
    except (ValueError, RecursionError, struct.error):
        return bytes_of_any(draw, case)
    which = draw(st.sampled_from(["tree", "tree", "binary", "both"]))
    if which != "tree":
        binary = damaged(draw, binary)
    text = json_bytes(draw, tree if which == "binary" else edited_tree(draw, tree))
    text += b" " * (-len(text) % 4)
    head = struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(binary))
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return case.with_file(case.main, head + chunks)


def _json_file(draw: Draw, case: Case, name: str) -> Case:
    try:
        tree = json.loads(case.files[name])
    except (ValueError, RecursionError):
        return bytes_of_any(draw, case)
    return case.with_file(name, json_bytes(draw, edited_tree(draw, tree)))


def gltf(draw: Draw, case: Case) -> Case:
    return _json_file(draw, case, case.main)


def obj(draw: Draw, case: Case) -> Case:
    name = draw(st.sampled_from([name for name in sorted(case.files) if not name.endswith(".png")]))
    keywords = ("v", "vt", "vn", "f", "usemtl", "mtllib", "newmtl", "map_Kd", "Kd", "l", "p", "g", "o", "d", "illum")
    return case.with_file(name, edited_lines(draw, case.files[name], keywords))


def ply(draw: Draw, case: Case) -> Case:
    data = case.files["a.ply"]
    lines = data[: data.find(b"end_header")].count(b"\n") + 1
    keywords = ("element vertex", "element face", "property list uchar int", "property float", "property double",
                "property uchar red", "comment TextureFile", "format ascii 1.0", "obj_info", "end_header")  # fmt: skip
    head = draw(st.sampled_from([lines, None]))
    return case.with_file("a.ply", edited_lines(draw, data, keywords, head))


def stl(draw: Draw, case: Case) -> Case:
    data = case.files["a.stl"]
    if data.lstrip().startswith(b"solid"):
        keywords = ("vertex", "facet normal", "outer loop", "endloop", "endfacet", "endsolid", "solid")
        return case.with_file("a.stl", edited_lines(draw, data, keywords))
    edited = bytearray(data)
    way = draw(st.sampled_from(["count", "coordinates", "face"]))
    if way == "count" and len(edited) >= 84:
        edited[80:84] = struct.pack("<I", draw(st.integers(0, 2**32 - 1)))
    elif len(edited) >= 134:
        face = draw(st.integers(0, (len(edited) - 84) // 50 - 1))
        start = 84 + 50 * face + (0 if way == "face" else 12 + 4 * draw(st.integers(0, 8)))
        values = draw(st.sampled_from([st.floats(-2, 2, width=32), st.floats(width=32)]))
        for at in range(start, start + (48 if way == "face" else 4), 4):
            edited[at : at + 4] = struct.pack("<f", draw(values))
    return case.with_file("a.stl", bytes(edited))


def threemf(draw: Draw, case: Case) -> Case:
    try:
        with zipfile.ZipFile(io.BytesIO(case.files["a.3mf"])) as archive:
            members = {name: archive.read(name) for name in archive.namelist()}
    except Exception:  # it is damaged already
        return bytes_of_any(draw, case)
    name = draw(st.sampled_from(sorted(members)))
    way = draw(st.sampled_from(["edit", "edit", "edit", "edit", "remove", "rename", "bytes"]))
    if way == "edit" and not name.endswith(".png"):
        members[name] = edited_xml(draw, members[name])
    elif way == "remove":
        del members[name]
    elif way == "rename":
        members["3D/" + draw(NAMES).replace("\ud800", "")] = members.pop(name)
    else:
        members[name] = damaged(draw, members[name])
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(zipfile.ZipInfo(name), content)
    return case.with_file("a.3mf", stream.getvalue())


def _arrays(draw: Draw) -> dict[str, np.ndarray]:
    arrays = dict(draw(st.sampled_from(fields())))
    for _ in range(draw(st.integers(1, 3))):
        key = draw(st.sampled_from(sorted(arrays)))
        way = draw(st.sampled_from(["other", "value", "remove", "type", "shape", "rename"]))
        array = arrays[key]
        if way == "other":
            arrays[key] = draw(ARRAYS)
        elif way == "value" and array.size:
            array = array.astype(np.float64).copy() if array.dtype.kind in "fiub" else array.copy()
            place = draw(st.integers(0, array.size - 1))
            array.reshape(-1)[place] = draw(NUMBERS) if array.dtype.kind == "f" else array.reshape(-1)[0]
            arrays[key] = array
        elif way == "remove":
            del arrays[key]
            if not arrays:
                return arrays
        elif way == "type" and array.dtype.kind in "fiub":
            with np.errstate(all="ignore"):
                arrays[key] = array.astype(draw(st.sampled_from(["<i2", "<u1", "<f2", "<f8", "?", "<c8", "<i8"])))
        elif way == "shape":
            arrays[key] = array[: array.shape[0] // 2] if array.ndim else array.reshape(1, 1)
        else:
            arrays[draw(st.sampled_from(["phi", "sdf", "coords", "feats", "colours", "rows", "weights"]))] = array
    return arrays


def npz(draw: Draw, case: Case) -> Case:
    stream = io.BytesIO()
    np.savez_compressed(stream, **_arrays(draw))
    data = stream.getvalue()
    if draw(st.sampled_from([True] + [False] * 4)):  # the header of a member, whose checksum is right again
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = {name: archive.read(name) for name in archive.namelist()}
        if members:
            name = draw(st.sampled_from(sorted(members)))
            head, rest = members[name][:118], members[name][118:]
            members[name] = head.replace(b"1", b"9") + rest if draw(st.booleans()) else damaged(draw, head) + rest
        stream = io.BytesIO()
        with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, content in members.items():
                archive.writestr(zipfile.ZipInfo(name), content)
        data = stream.getvalue()
    return case.with_file(case.main, data)


def safetensors(draw: Draw, case: Case) -> Case:
    if draw(st.booleans()):
        arrays = {key: np.ascontiguousarray(a) for key, a in _arrays(draw).items() if a.dtype.kind in "fiub"}
        return case.with_file(case.main, save(arrays))
    data = case.files[case.main]
    size = int.from_bytes(data[:8], "little")
    try:
        tree = json.loads(data[8 : 8 + size])
    except (ValueError, RecursionError):
        return bytes_of_any(draw, case)
    text = json_bytes(draw, edited_tree(draw, tree))
    return case.with_file(case.main, len(text).to_bytes(8, "little") + text + data[8 + size :])


def _tensor(draw: Draw, array: np.ndarray) -> Any:
    if array.dtype.kind not in "fiubc":
        return draw(VALUES)
    tensor = torch.as_tensor(np.ascontiguousarray(array))
    half = tensor if tensor.is_complex() else tensor.to(torch.bfloat16)
    return draw(st.sampled_from([tensor] * 5 + [half, tensor.to_sparse(), {"inner": tensor}]))


def pt(draw: Draw, case: Case) -> Case:
    content: Any = {key: _tensor(draw, array) for key, array in _arrays(draw).items()}
    if draw(st.sampled_from([True] + [False] * 9)):
        content = draw(VALUES)
    return case.with_file(case.main, torch_file(content))


def image(draw: Draw, case: Case) -> Case:
    """The size that the head of a PNG tells, with a checksum that is right."""
    data = bytearray(case.files[case.main])
    if data[:4] != b"\x89PNG" or len(data) < 33:
        return bytes_of_any(draw, case)
    at = draw(st.sampled_from([16, 20]))
    data[at : at + 4] = struct.pack(">I", draw(st.sampled_from([0, 1, 9000, 20000, 100_000, 2**31 - 1, 2**32 - 1])))
    if draw(st.booleans()):
        data[24:26] = bytes([draw(st.sampled_from([1, 2, 8, 16, 77])), draw(st.integers(0, 7))])
    data[29:33] = struct.pack(">I", zlib.crc32(data[12:29]))
    return case.with_file(case.main, bytes(data))


def _edited_state(draw: Draw, state: Any) -> Any:
    """A checkpoint with one of its values replaced."""
    inner = list(state.items() if isinstance(state, dict) else enumerate(state))
    key, value = inner[draw(st.integers(0, len(inner) - 1))]
    if isinstance(value, (dict, list, tuple)) and value and draw(st.booleans()):
        new = _edited_state(draw, value)
    else:
        tensors = [torch.zeros(2), torch.full((5, 3), torch.nan), torch.zeros(5, 3)]
        new = draw(st.one_of(VALUES, st.sampled_from(tensors)))
    if isinstance(state, dict):
        return {**state, key: new}
    items = [new if index == key else one for index, one in inner]
    return type(state)(items)


def run(draw: Draw, case: Case) -> Case:
    name = draw(st.sampled_from(sorted(case.files)))
    if name == "metrics.json":
        return _json_file(draw, case, name)
    if name == "checkpoint.pt":
        try:
            state = torch.load(io.BytesIO(case.files[name]), weights_only=True)
            return case.with_file(name, torch_file(_edited_state(draw, state)))
        except Exception:  # it is damaged already
            return bytes_of_any(draw, case)
    return case.with_file(name, edited_lines(draw, case.files[name], ("asset:", "size_mm:", "- ", '{"iteration":')))


def scene(draw: Draw, case: Case) -> Case:
    return case.with_file(case.main, edited_xml(draw, case.files[case.main]))

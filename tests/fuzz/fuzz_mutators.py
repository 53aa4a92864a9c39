"""Damage to files, as Hypothesis strategies: bytes of any kind, and the structure of each."""

from __future__ import annotations

import io
import json
import re
import struct
import zipfile
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import torch
from fuzz_seeds import Case, fields, seeds, shape_arrays, shape_file, torch_file
from hypothesis import strategies as st
from safetensors.numpy import save

Draw = Callable[[st.SearchStrategy[Any]], Any]

NUMBERS = st.one_of(
    st.sampled_from(
        [0, -1, 1, 2, 3, 255, 256, 65535, 65536, 2**31 - 1, 2**31, -(2**31), 2**32 - 1, 2**40, 2**62, 2**63, -(2**63),
         10**30, 0.5, -0.0, 1e-30, 1e-320, 1e9, 1e15, 1e30, 1e100, 1e200, 1e308, float("inf"), float("-inf"),
         float("nan")]
    ),
    st.integers(-10, 400),
    st.floats(),
)  # fmt: skip
"""What no writer writes."""
NAMES = st.sampled_from(
    ["", ".", "..", "/", "/etc/passwd", "/dev/zero", "../../a.obj", "a.obj", "a.glb", "a.png", "paint.png", "C:\\a.png",
     "data:", "data:;base64,!!!", "x" * 5000, "\0", "é\u202e", "%00", "%2e%2e/a", "~", "a.mtl a.mtl", "\ud800"]
)  # fmt: skip
"""Of files, and text where a number is due."""
MILD = st.one_of(st.floats(-2, 2).map(lambda x: f"{x:.3f}"), st.integers(1, 40).map(str))
ODD = st.one_of(NUMBERS.map(repr), NAMES, st.sampled_from(["#", '"', "1/2/3/4", "/", "//", "\\", "\t", "NaN", "-"]))
WORDS = st.sampled_from([MILD, MILD, MILD, ODD]).flatmap(lambda words: words)
FEW = st.sampled_from([1, 1, 1, 2, 4])
"""Edits of one file."""
VALUES = st.one_of(
    NUMBERS, NAMES, st.none(), st.booleans(), st.lists(NUMBERS, max_size=5), st.builds(dict), st.builds(list)
)
ARRAYS = st.sampled_from(
    [np.zeros(0), np.zeros((0, 3)), np.zeros((3, 3)), np.ones((4, 4, 4)), np.array(7), np.array("text"),
     np.array(["a", "b"]), np.zeros(5, bool), np.zeros((2, 2), complex), np.full((9, 9, 9), np.nan, np.float32),
     np.full(1000, -1e30), np.zeros((2,) * 20, np.int8), np.arange(729).reshape(9, 9, 9), np.array(1e300),
     np.array(np.datetime64("2020-01-01")), np.full((5, 4), 2**62), np.float16([60000] * 64).reshape(4, 4, 4)]
)  # fmt: skip
"""Of other types and shapes than a shape has."""


def mutated(kind: str) -> st.SearchStrategy[Case]:
    """Damaged inputs of one kind; some are left as they are."""

    @st.composite
    def cases(draw: Draw) -> Case:
        case = draw(st.sampled_from(seeds(kind)))
        for _ in range(draw(st.sampled_from([0, 1, 1, 1, 1, 1, 2, 3]))):
            ways = [_bytes_of_any] * (kind != "shape") + [_STRUCTURE[kind]] * 4
            case = draw(st.sampled_from(ways))(draw, case)
        return case

    return cases()


def _bytes_of_any(draw: Draw, case: Case) -> Case:
    name = draw(st.sampled_from(sorted(case.files)))
    return case.with_file(name, damaged(draw, case.files[name]))


def damaged(draw: Draw, data: bytes) -> bytes:
    """A few bytes changed, cut out, put in, or repeated."""
    edited = bytearray(data)
    for _ in range(draw(FEW)):
        at = draw(st.integers(0, max(0, len(edited) - 1)))
        length = draw(st.sampled_from([1, 2, 4, 8, 64, 1000]))
        way = draw(st.sampled_from(["flip", "number", "mild", "mild", "cut", "insert", "repeat", "end", "zero"]))
        if way == "flip" and edited:
            edited[at] ^= draw(st.integers(1, 255))
        elif way == "number":
            edited[at : at + 4] = draw(st.one_of(st.integers(0, 2**32 - 1).map(lambda x: struct.pack("<I", x)),
                                                 st.floats(width=32).map(lambda x: struct.pack("<f", x))))  # fmt: skip
        elif way == "mild":  # numbers as a coordinate may have them
            few = draw(st.lists(st.floats(-2, 2, width=32), min_size=1, max_size=12))
            edited[at // 4 * 4 : at // 4 * 4 + 4 * len(few)] = struct.pack(f"<{len(few)}f", *few)
        elif way == "cut":
            del edited[at : at + length]
        elif way == "insert":
            edited[at:at] = draw(st.binary(min_size=1, max_size=16))
        elif way == "repeat":
            edited[at:at] = bytes(edited[at : at + length]) * draw(st.sampled_from([1, 3, 50]))
        elif way == "end":
            del edited[at:]
        else:
            edited[at : at + length] = bytes(length)
    return bytes(edited)


# JSON


def paths(tree: Any, above: tuple = ()) -> list[tuple]:
    """Where all values of a tree are, but for its root."""
    inner = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    return [path for key, value in inner for path in [(*above, key), *paths(value, (*above, key))]]


def _at(tree: Any, path: tuple) -> Any:
    for key in path:
        tree = tree[key]
    return tree


GLTF_KEYS = ("byteStride", "byteOffset", "count", "sparse", "normalized", "children", "matrix", "weights", "skin",
             "mesh", "camera", "extensions", "extensionsRequired", "indices", "targets", "mode", "emissiveTexture",
             "emissiveFactor", "alphaMode", "texCoord", "source", "uri", "bufferView", "componentType", "type", "scene",
             "name")  # fmt: skip


def edited_tree(draw: Draw, tree: Any) -> Any:
    """A JSON tree with a few values replaced, removed, added or put elsewhere."""
    tree = json.loads(json.dumps(tree))
    for _ in range(draw(FEW)):
        every = paths(tree)
        if not every:
            return draw(VALUES)
        path = every[draw(st.integers(0, len(every) - 1))]
        parent, key = _at(tree, path[:-1]), path[-1]
        way = draw(st.sampled_from(["replace", "replace", "remove", "move", "add"]))
        if way == "replace":
            parent[key] = draw(VALUES)
        elif way == "remove":
            del parent[key]
        elif way == "move":
            parent[key] = json.loads(json.dumps(_at(tree, every[draw(st.integers(0, len(every) - 1))])))
        elif isinstance(parent, dict):
            parent[draw(st.sampled_from(GLTF_KEYS))] = draw(VALUES)
        else:
            parent.append(draw(VALUES))
    return tree


def json_bytes(draw: Draw, tree: Any) -> bytes:
    """A tree as text, or text that nests without end."""
    text = json.dumps(tree)
    if draw(st.sampled_from([False] * 60 + [True])):
        text = text[:-1] + ', "deep": ' + "[" * 100_000
    return text.encode("utf-8", "surrogatepass")


def _glb(draw: Draw, case: Case) -> Case:
    data = case.files[case.main]
    try:
        size = struct.unpack_from("<I", data, 12)[0]
        tree, binary = json.loads(data[20 : 20 + size]), data[28 + size :]
    except (ValueError, RecursionError, struct.error):
        return _bytes_of_any(draw, case)
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
        return _bytes_of_any(draw, case)
    return case.with_file(name, json_bytes(draw, edited_tree(draw, tree)))


def _gltf(draw: Draw, case: Case) -> Case:
    return _json_file(draw, case, case.main)


# Text


def edited_lines(draw: Draw, data: bytes, keywords: tuple[str, ...] = (), head: int | None = None) -> bytes:
    """Lines with words replaced, or removed, doubled, swapped and put in; only the first ``head`` of them if given."""
    lines = data.split(b"\n")
    for _ in range(draw(FEW)):
        at = draw(st.integers(0, max(0, min(len(lines), head or len(lines)) - 1)))
        way = draw(st.sampled_from(["word", "word", "word", "remove", "double", "swap", "new"]))
        words = lines[at].split(b" ") if lines else []
        if way == "word" and words:
            words[draw(st.integers(0, len(words) - 1))] = draw(WORDS).encode("utf-8", "surrogatepass")
            lines[at] = b" ".join(words)
        elif way == "remove":
            del lines[at : at + draw(st.sampled_from([1, 1, 10]))]
        elif way == "double" and lines:
            lines[at:at] = [lines[at]] * draw(st.sampled_from([1, 2, 1000]))
        elif way == "swap" and lines:
            other = draw(st.integers(0, len(lines) - 1))
            lines[at], lines[other] = lines[other], lines[at]
        elif keywords:
            new = [draw(st.sampled_from(keywords)), *draw(st.lists(WORDS, max_size=6))]
            lines.insert(at, " ".join(new).encode("utf-8", "surrogatepass"))
    return b"\n".join(lines)


def _obj(draw: Draw, case: Case) -> Case:
    name = draw(st.sampled_from([name for name in sorted(case.files) if not name.endswith(".png")]))
    keywords = ("v", "vt", "vn", "f", "usemtl", "mtllib", "newmtl", "map_Kd", "Kd", "l", "p", "g", "o", "d", "illum")
    return case.with_file(name, edited_lines(draw, case.files[name], keywords))


def _ply(draw: Draw, case: Case) -> Case:
    data = case.files["a.ply"]
    lines = data[: data.find(b"end_header")].count(b"\n") + 1
    keywords = ("element vertex", "element face", "property list uchar int", "property float", "property double",
                "property uchar red", "comment TextureFile", "format ascii 1.0", "obj_info", "end_header")  # fmt: skip
    head = draw(st.sampled_from([lines, None]))
    return case.with_file("a.ply", edited_lines(draw, data, keywords, head))


def _stl(draw: Draw, case: Case) -> Case:
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


def edited_xml(draw: Draw, data: bytes) -> bytes:
    """Markup with attributes changed, and elements removed, doubled, or put elsewhere."""
    for _ in range(draw(FEW)):
        tags = list(re.finditer(rb"<[^>]*>", data))
        values = list(re.finditer(rb'="([^"]*)"', data))
        way = draw(st.sampled_from(["value", "value", "value", "remove", "double", "move"]))
        if way == "value" and values:
            one = values[draw(st.integers(0, len(values) - 1))]
            word = re.sub('["<&\0\ud800]', "", draw(WORDS)).encode()  # what XML itself forbids says nothing of us
            data = data[: one.start(1)] + word + data[one.end(1) :]
        elif tags:
            one = tags[draw(st.integers(0, len(tags) - 1))]
            other = tags[draw(st.integers(0, len(tags) - 1))]
            text = b"" if way == "remove" else one[0] * 2 if way == "double" else other[0]
            data = data[: one.start()] + text + data[one.end() :]
    return data


def _threemf(draw: Draw, case: Case) -> Case:
    try:
        with zipfile.ZipFile(io.BytesIO(case.files["a.3mf"])) as archive:
            members = {name: archive.read(name) for name in archive.namelist()}
    except Exception:  # it is damaged already
        return _bytes_of_any(draw, case)
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
            archive.writestr(name, content)
    return case.with_file("a.3mf", stream.getvalue())


# Arrays


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


def _npz(draw: Draw, case: Case) -> Case:
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
                archive.writestr(name, content)
        data = stream.getvalue()
    return case.with_file(case.main, data)


def _safetensors(draw: Draw, case: Case) -> Case:
    if draw(st.booleans()):
        arrays = {key: np.ascontiguousarray(a) for key, a in _arrays(draw).items() if a.dtype.kind in "fiub"}
        return case.with_file(case.main, save(arrays))
    data = case.files[case.main]
    size = int.from_bytes(data[:8], "little")
    try:
        tree = json.loads(data[8 : 8 + size])
    except (ValueError, RecursionError):
        return _bytes_of_any(draw, case)
    text = json_bytes(draw, edited_tree(draw, tree))
    return case.with_file(case.main, len(text).to_bytes(8, "little") + text + data[8 + size :])


def _tensor(draw: Draw, array: np.ndarray) -> Any:
    if array.dtype.kind not in "fiubc":
        return draw(VALUES)
    tensor = torch.as_tensor(np.ascontiguousarray(array))
    half = tensor if tensor.is_complex() else tensor.to(torch.bfloat16)
    return draw(st.sampled_from([tensor] * 5 + [half, tensor.to_sparse(), {"inner": tensor}]))


def _pt(draw: Draw, case: Case) -> Case:
    content: Any = {key: _tensor(draw, array) for key, array in _arrays(draw).items()}
    if draw(st.sampled_from([True] + [False] * 9)):
        content = draw(VALUES)
    return case.with_file(case.main, torch_file(content))


# The rest


def _shape(draw: Draw, case: Case) -> Case:
    """A mesh whose file is sound and whose surface is not: torn, flat, crossing itself, in many pieces."""
    vertices, faces, rgb = shape_arrays(case.files[case.main])
    pick, few = np.random.default_rng(draw(st.integers(0, 2**32 - 1))), draw(st.sampled_from([1, 5, 40, 400]))
    way = draw(st.sampled_from(["move", "garbage", "tear", "turn", "double", "flatten", "far", "weld", "inside",
                                "twist", "scale", "shift", "indices", "mirror"]))  # fmt: skip
    rows, corners = pick.integers(0, len(faces), few), pick.integers(0, len(vertices), few)
    if way == "move":
        vertices[corners] += pick.normal(0, 0.3, (few, 3))
    elif way == "garbage":
        vertices[:] = pick.uniform(-1, 1, vertices.shape)
    elif way == "tear":
        faces = np.delete(faces, rows, axis=0)
    elif way == "turn":
        faces[rows] = faces[rows][:, ::-1]
    elif way == "double":
        faces = np.concatenate([faces, faces[rows]])
    elif way == "flatten":
        vertices[:, draw(st.integers(0, 2))] *= draw(st.sampled_from([0.0, 1e-12, 1e-6, 1e-3]))
    elif way == "far":
        vertices[corners] *= draw(st.sampled_from([1e2, 1e4, 1e8, 1e14]))
    elif way == "weld":
        vertices[corners] = vertices[corners[0]]
    elif way in ("inside", "mirror"):
        size = -1.0 if way == "mirror" else draw(st.sampled_from([0.5, 0.99, 1.0, -0.8]))
        shift = pick.normal(0, draw(st.sampled_from([0.0, 1e-7, 0.3, 3.0])), 3)
        faces = np.concatenate([faces, faces + len(vertices)])
        vertices, rgb = np.concatenate([vertices, size * vertices + shift]), np.concatenate([rgb, rgb])
    elif way == "twist":
        angle = draw(st.sampled_from([2, 20])) * vertices[:, 1]
        x, z = vertices[:, 0].copy(), vertices[:, 2].copy()
        vertices[:, 0], vertices[:, 2] = x * np.cos(angle) - z * np.sin(angle), x * np.sin(angle) + z * np.cos(angle)
    elif way in ("scale", "shift"):
        number = draw(st.sampled_from([1e-38, 1e-20, 1e-9, 1e6, 1e14, 1e30]))
        vertices = vertices * number if way == "scale" else vertices + number
    else:
        faces[rows] = pick.integers(0, len(vertices), (few, 3))
    return case.with_file(case.main, shape_file(vertices, faces, rgb))


# And the rest


def _image(draw: Draw, case: Case) -> Case:
    """The size that the head of a PNG tells, with a checksum that is right."""
    import zlib

    data = bytearray(case.files[case.main])
    if data[:4] != b"\x89PNG" or len(data) < 33:
        return _bytes_of_any(draw, case)
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


def _run(draw: Draw, case: Case) -> Case:
    name = draw(st.sampled_from(sorted(case.files)))
    if name == "metrics.json":
        return _json_file(draw, case, name)
    if name == "checkpoint.pt":
        try:
            state = torch.load(io.BytesIO(case.files[name]), weights_only=True)
            return case.with_file(name, torch_file(_edited_state(draw, state)))
        except Exception:  # it is damaged already
            return _bytes_of_any(draw, case)
    return case.with_file(name, edited_lines(draw, case.files[name], ("asset:", "size_mm:", "- ", '{"iteration":')))


def _scene(draw: Draw, case: Case) -> Case:
    return case.with_file(case.main, edited_xml(draw, case.files[case.main]))


_STRUCTURE: dict[str, Callable[[Draw, Case], Case]] = {
    "glb": _glb, "gltf": _gltf, "obj": _obj, "ply": _ply, "stl": _stl, "3mf": _threemf, "npz": _npz,
    "safetensors": _safetensors, "pt": _pt, "image": _image, "run": _run, "scene": _scene, "shape": _shape,
}  # fmt: skip


@cache
def inputs(kind: str, seed: int, count: int) -> tuple[Case, ...]:
    """``count`` inputs of one kind, the same ones for the same ``seed``."""
    from hypothesis import HealthCheck, Phase, given, settings
    from hypothesis import seed as seeded

    made: list[Case] = []

    @seeded(seed)
    @settings(max_examples=count, database=None, deadline=None, phases=[Phase.generate],
              suppress_health_check=list(HealthCheck))  # fmt: skip
    @given(mutated(kind))
    def collect(case: Case) -> None:
        made.append(case)

    collect()
    return tuple(made[:count])

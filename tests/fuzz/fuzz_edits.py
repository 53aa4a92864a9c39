"""Edits of files that know how they are made: bytes, JSON trees, lines, markup."""

from __future__ import annotations

import json
import re
import struct
from collections.abc import Callable
from typing import Any

import numpy as np
from hypothesis import strategies as st

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

"""PLY: vertex colours as different writers name and type them."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from genmf_mi.assets import asset
from genmf_mi.core.colour import to_linear
from genmf_mi.core.errors import AssetError

BALL = trimesh.creation.icosphere(2)
GREY = np.where(BALL.vertices[:, 1] > 0, 204, 51)
KINDS = {"uchar": "u1", "ushort": "<u2", "float": "<f4", "double": "<f8"}


def ply(kind: str, names: tuple[str, ...], values: np.ndarray) -> bytes:
    row = np.zeros(len(GREY), np.dtype([("p", "<f4", 3), ("c", KINDS[kind], len(names))]))
    row["p"], row["c"] = BALL.vertices, values[:, None]
    face = np.zeros(len(BALL.faces), np.dtype([("k", "u1"), ("i", "<i4", 3)]))
    face["k"], face["i"] = 3, BALL.faces
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(row)}"]
    head += [f"property float {axis}" for axis in "xyz"] + [f"property {kind} {name}" for name in names]
    head += [f"element face {len(face)}", "property list uchar int vertex_indices", "end_header", ""]
    return "\n".join(head).encode() + row.tobytes() + face.tobytes()


RGB = ("red", "green", "blue")


@pytest.mark.parametrize(
    ("kind", "names", "scale"),
    [
        ("uchar", RGB, 1),
        ("uchar", ("Red", "Green", "Blue"), 1),
        ("uchar", ("diffuse_red", "diffuse_green", "diffuse_blue"), 1),
        ("uchar", ("r", "g", "b"), 1),
        ("uchar", (*RGB, "alpha"), 1),
        ("ushort", RGB, 257),
        ("float", RGB, 1 / 255),
        ("float", RGB, 1),
        ("double", ("r", "g", "b"), 1 / 255),
    ],
)
def test_the_same_bands_from_each(tmp_path, kind, names, scale):
    (tmp_path / "a.ply").write_bytes(ply(kind, names, GREY * scale))
    found = asset.load(tmp_path / "a.ply")
    assert found.textured
    expected = to_linear(GREY / 255)
    np.testing.assert_allclose(found.albedo.colours, np.repeat(expected[:, None], 3, axis=1), atol=2e-3)


def test_colours_that_are_not_numbers(tmp_path):
    (tmp_path / "a.ply").write_bytes(ply("float", RGB, np.where(GREY > 100, np.nan, 1.0)))
    with pytest.raises(AssetError, match="colours that are not numbers"):
        asset.load(tmp_path / "a.ply")


def test_splats_are_named(tmp_path):
    (tmp_path / "a.ply").write_bytes(ply("float", ("f_dc_0", "f_dc_1", "f_dc_2"), GREY / 255))
    with pytest.raises(AssetError, match="Gaussian splats"):
        asset.load(tmp_path / "a.ply")

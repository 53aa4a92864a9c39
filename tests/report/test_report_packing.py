"""The mesh of the 3D view."""

from __future__ import annotations

import base64
import dataclasses
import json
import re
import zlib

import numpy as np
import pytest
from lxml import html
from scipy.spatial import cKDTree
from toy_report import MATERIAL, sphere

from genmf_mi.core.colour import to_srgb
from genmf_mi.report import Report, packing
from genmf_mi.report.page import render


def unpack(packed: packing.Packed) -> dict[str, np.ndarray]:
    """The slow, obvious inverse of the packing, as viewer.js does it."""
    stream, at, columns = zlib.decompress(base64.b64decode(packed.data)), 0, []
    meta = packed.meta
    n = meta["vertices"]
    for index, width in enumerate(meta["widths"]):
        count = 3 * meta["faces"] if index == len(meta["widths"]) - 1 else n
        total, column = 0, []
        for i in range(count):
            folded = sum(stream[at + plane * count + i] << (8 * plane) for plane in range(width))
            total += -(folded + 1) // 2 if folded % 2 else folded // 2
            column.append(total)
        at += width * count
        columns.append(np.array(column))
    assert at == len(stream)
    refined = np.stack(columns[:3], 1)
    rest = columns[3:]
    residual = 0
    if meta["hasOriginal"]:
        residual, rest = np.stack(rest[:3], 1), rest[3:]
    return {
        "refined": np.array(meta["low"]) + meta["step"] * refined,
        "original": np.array(meta["low"]) + meta["step"] * (refined + residual),
        "colours": np.stack(rest[:3], 1),
        "relief": rest[3] * meta["reliefStep"],
        "faces": rest[4].reshape(-1, 3),
    }


@pytest.mark.parametrize("with_original", [True, False])
def test_embedded_mesh_is_the_mesh(report, with_original):
    if not with_original:
        report = dataclasses.replace(report, original=None)
    page = html.document_fromstring(render(report))
    meta = json.loads(page.get_element_by_id("mesh-meta").text)
    mesh = unpack(packing.Packed(meta, page.get_element_by_id("mesh-data").text))
    half = meta["step"] / 2 * 1.001 + 1e-9
    distance, match = cKDTree(report.vertices).query(mesh["refined"])
    assert sorted(match) == list(range(len(report.vertices))) and distance.max() <= np.sqrt(3) * half
    if with_original:
        assert np.abs(mesh["original"] - report.original[match]).max() <= half
    assert np.abs(mesh["relief"] - report.relief_mm[match]).max() <= meta["reliefStep"] / 2 + 1e-9
    assert np.abs(mesh["colours"] / 255 - to_srgb(report.colours[match])).max() <= 0.5 / 255 + 1e-6

    def turned(faces):
        return sorted(tuple(np.roll(face, -face.argmin())) for face in faces)

    assert turned(match[mesh["faces"]]) == turned(report.faces)
    assert bool(page.xpath("//input[@name='shape']")) == with_original


def test_view_is_lit_as_the_renders_are(report):
    """The page hands the material over, and the script uses all of it and knows no other."""
    page = html.document_fromstring(render(report))
    assert json.loads(page.get_element_by_id("mesh-meta").text)["material"] == MATERIAL
    script = page.xpath("//script")[-1].text
    shader = script[script.index("const FRAGMENT") : script.index("function vertexNormals")]
    for name in MATERIAL:
        assert re.search(rf'material\.{name}\b|"{name}"', script), name
        assert name == "lights" or re.search(rf"uniform [^;]*\b{name}\b[^;]*;", shader), name
    shading = shader[shader.index("float softplus") : shader.index("if (surface == 2)")]
    assert set(re.findall(r"\d+(?:\.\d+)?", shading)) <= {"0.0", "1.0", "1", "3"}


def test_view_opens_where_the_relief_is(report):
    # The fixture raises x > 0.3 most
    assert packing.pack(report).meta["azimuth"] == 90


def test_large_mesh_is_simplified_and_the_page_says_so(report, monkeypatch):
    monkeypatch.setattr(packing, "MAX_FACES", 1500)
    mesh = unpack(packed := packing.pack(report))
    assert 500 < packed.meta["faces"] <= 1500
    assert mesh["faces"].max() == packed.meta["vertices"] - 1
    a, b, c = (mesh["refined"][mesh["faces"][:, k]] for k in range(3))
    volume = np.einsum("ij,ij->", a, np.cross(b, c)) / 6
    assert volume == pytest.approx(4 / 3 * np.pi * 0.95**3, rel=0.06)
    assert f"simplified mesh of {packed.meta['faces']} of {len(report.faces)} faces" in render(report)


def test_embedded_mesh_of_realistic_size_stays_small():
    vertices, faces = sphere(250, 320)
    grey = (np.sin(20 * vertices[:, :1]) > 0).repeat(3, axis=1).astype(np.float32)
    report = Report("x", [], [], {}, {}, vertices * 1.01, faces, grey, grey[:, 0] * 0.5, 1.0, 100.0, MATERIAL,
                    original=vertices)  # fmt: skip
    assert len(faces) == 160_000
    assert len(packing.pack(report).data) < 3e6

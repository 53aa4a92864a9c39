"""What the page says of a model: pictures of all formats, faults in words, and broken files refused in words."""

from __future__ import annotations

import json
import re
import zipfile
from pathlib import Path

import numpy as np
import pytest
import trimesh
from gltf_writer import Gltf
from textured import checkered_ball
from toys import egg, painted

from genmf_mi.assets import asset as meshes
from genmf_mi.ui import analysis, uploads
from genmf_mi.ui.preview_model import write_model


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    """Of a job; the tests work in its ``input``, as the process does."""
    (tmp_path / "input").mkdir()
    monkeypatch.chdir(tmp_path / "input")
    return tmp_path


def codes(result: dict) -> set[str]:
    return {finding["code"] for finding in result["findings"]}


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".glb"])
def test_a_sound_model(folder, suffix):
    name = Path(painted(f"toy{suffix}")).name
    read = analysis.read(folder, name, "auto")
    assert read["state"] == "checking" and read["model"]["textured"] and read["model"]["faces"] == 1280
    assert read["model"]["extent"] == pytest.approx([2, 1.6, 1.8], rel=0.02)
    checked = analysis.check(folder, name, "auto")
    assert checked["state"] == "done" and codes(checked) == {"solid"}
    assert json.loads((folder / "analysis.json").read_text()) == checked


def test_holes_crumbs_and_missing_colours_are_told(folder):
    mesh, crumb = egg(), trimesh.creation.icosphere(1, radius=0.02)
    mesh.update_faces(np.arange(len(mesh.faces)) > 5)
    crumb.apply_translation([3, 0, 0])
    (mesh + crumb).export("toy.stl")
    assert codes(analysis.read(folder, "toy.stl", "auto")) == {"no-texture"}
    found = analysis.check(folder, "toy.stl", "auto")
    assert {"no-texture", "holes-closed", "loose-parts-removed"} <= codes(found)


def test_another_axis_upwards(folder):
    painted("toy.ply")
    upright, turned = (analysis.read(folder, "toy.ply", up) for up in ("auto", "z"))
    x, y, z = upright["model"]["extent"]
    assert turned["model"]["extent"] == pytest.approx([x, z, y])
    turn = np.array(turned["turn"]).reshape(3, 3)
    assert meshes.load("toy.ply", "z").vertices == pytest.approx(meshes.load("toy.ply").vertices @ turn.T)


def test_picture_of_a_textured_model_is_the_model(folder):
    """Read back by trimesh: the same corners with the same texture at them."""
    asset = meshes.load(checkered_ball(folder / "ball.glb"))
    write_model(folder / "model.glb", asset)
    (back,) = trimesh.load(folder / "model.glb", process=False).geometry.values()
    assert np.allclose(back.vertices[back.faces], asset.vertices[asset.faces], atol=1e-5)
    (material,) = [m for m in asset.albedo.materials if m.texture is not None]
    assert np.array_equal(np.asarray(back.visual.material.baseColorTexture.convert("RGB")), material.texture.pixels)
    uv = np.column_stack([asset.albedo.uv[:, 0], 1 - asset.albedo.uv[:, 1]])  # trimesh has v upwards
    assert np.allclose(back.visual.uv[back.faces], uv[asset.faces], atol=1e-5)


def test_picture_has_vertex_colours_and_every_material(folder):
    asset = meshes.load(painted("toy.ply"))
    write_model(folder / "model.glb", asset)
    again = meshes.load(folder / "model.glb")
    assert np.allclose(again.albedo.colours, asset.albedo.colours, atol=1e-4)
    assert np.array_equal(again.faces, asset.faces)


def broken_files(folder: Path) -> dict[str, str]:
    """Broken files by name, and what must be said of them."""
    whole = {suffix: Path(painted(folder / f"whole{suffix}")).read_bytes() for suffix in (".glb", ".ply", ".stl")}
    for suffix, data in whole.items():
        (folder / f"cut{suffix}").write_bytes(data[: len(data) // 2])
    (folder / "text.3mf").write_bytes(b"solid nonsense")
    (folder / "text.glb").write_bytes(b"nonsense" * 9)
    Gltf().glb(folder / "no.glb")
    mesh = egg()
    mesh.vertices[10, 1] = np.nan
    mesh.export(folder / "nan.ply")
    (folder / "sheet.obj").write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3\nf 1 3 4\n")
    (folder / "toy.obj").write_text("mtllib toy.mtl\nusemtl a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/1 2/1 3/1\n")
    return {
        "cut.glb": "truncated", "cut.ply": "cannot be read as PLY", "cut.stl": "truncated", "text.3mf": "as 3MF",
        "text.glb": "not glTF", "no.glb": "no triangles", "nan.ply": "not numbers", "sheet.obj": "sheet without",
    }  # fmt: skip


def test_broken_files_are_refused_in_words(client, tmp_path):
    """Without a traceback, a path of the server, or a job that cannot be looked at."""
    for name, words in broken_files(tmp_path).items():
        job = client.upload(tmp_path / name)
        assert job["analysis"]["state"] == "failed", name
        error = job["analysis"]["error"]
        assert re.search(words, error) and str(tmp_path) not in error and "Traceback" not in error
        status, answer = client.ask("POST", f"jobs/{job['id']}/start", {})
        assert status == 422 and answer["error"]["message"] == error
    for name, content, words in (
        ("empty.glb", b"", "is empty"), ("toy.fbx", b"Kaydara", "no model"), ("toy", b"x", "no model"),
        ("toy.zip", b"x", "zip cannot be read"),
    ):  # fmt: skip
        status, answer = client.ask("POST", f"jobs?name={name}", body=content)
        assert status == 422 and answer["error"]["code"] == "asset" and words in answer["error"]["message"]
    assert len(list((client.workspace / "jobs").iterdir())) == len(broken_files(tmp_path))


def test_an_archive_with_textures(client, tmp_path):
    (tmp_path / "obj").mkdir()
    checkered_ball(tmp_path / "obj" / "ball.obj")
    with zipfile.ZipFile(tmp_path / "toy.zip", "w") as archive:
        for path in (tmp_path / "obj").iterdir():
            archive.write(path, f"a folder/{path.name}")
    job = client.upload(tmp_path / "toy.zip")
    assert job["name"] == "ball" and job["model"] == "a folder/ball.obj" and job["analysis"]["model"]["textured"]
    status, headers, body = client.raw("GET", f"/api/jobs/{job['id']}/model.glb")
    assert status == 200 and headers["content-type"] == "model/gltf-binary" and body[:4] == b"glTF"


def test_an_upload_that_is_too_large_is_refused_at_once(client):
    """By its length, before a byte is read."""
    status, _, body = client.raw("POST", "/api/jobs?name=a.glb", headers={"Content-Length": str(uploads.MAX_BYTES + 1)})
    assert status == 413 and "larger than 256 MB" in json.loads(body)["error"]["message"]
    assert list((client.workspace / "jobs").iterdir()) == []

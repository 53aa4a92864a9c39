"""The whole way in a real browser, with the real refinement: drop, paint, start, compare, download, and the part."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path

import lib3mf
import numpy as np
import pytest
from browser import opened, pixels, until
from page_server import Served
from textured import checkered_ball

from genmf_mi.assets import asset as meshes
from genmf_mi.losses import lpips_weights
from genmf_mi.mesh.nearest import distance_to_surface

SIZE = 60
QUICK = {"iterations": 10, "resolution": 128, "samples": 2, "max_faces": 24_000}


def paint_the_left_half(page) -> None:
    page.click("[data-kind=flat]")
    page.fill("#brush", "20")
    box = page.locator("#canvas").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    radius = 0.4 * min(box["width"], box["height"])
    for row in np.linspace(-0.8, 0.8, 7):
        page.mouse.move(x - 0.95 * radius * np.sqrt(1 - row**2), y + row * radius)
        page.mouse.down()
        page.mouse.move(x - 0.3 * radius, y + row * radius, steps=8)
        page.mouse.up()


def read_3mf(path: Path) -> tuple[np.ndarray, np.ndarray, bool]:
    """Vertices in mm, faces, and whether it is closed, as lib3mf has it."""
    model = lib3mf.Wrapper().CreateModel()
    model.QueryReader("3mf").ReadFromFile(str(path))
    items = model.GetMeshObjects()
    assert items.MoveNext()
    mesh = items.GetCurrentMeshObject()
    vertices = np.array([tuple(v.Coordinates) for v in mesh.GetVertices()])
    faces = np.array([tuple(t.Indices) for t in mesh.GetTriangleIndices()])
    return vertices, faces, bool(mesh.IsManifoldAndOriented())


def near(points: np.ndarray, strokes: list[dict], margin_mm: float) -> np.ndarray:
    """Which points ``[N,3]`` in the coordinates of the file lie within the strokes, widened by a margin."""
    found = np.zeros(len(points), bool)
    for stroke in strokes:
        corners = np.array(stroke["points"])
        along = np.concatenate([a + np.linspace(0, 1, 20)[:, None] * (b - a) for a, b in pairwise(corners)])
        reach = (stroke["radius_mm"] + margin_mm) * 2 / SIZE
        found |= np.linalg.norm(points[:, None] - along[None], axis=2).min(axis=1) < reach
    return found


@pytest.mark.skipif("alex" in lpips_weights.missing(), reason="the LPIPS weights are not installed")
def test_from_a_file_to_a_print(tmp_path):
    # Finely, as what is meshed anew leaves coarse facets by more than the relief that is looked for
    ball = checkered_ball(tmp_path / "ball.glb", rows=96)
    server = Served(tmp_path / "workspace")

    def quicker(route) -> None:
        wanted = json.loads(route.request.post_data)
        wanted["settings"] |= QUICK
        route.continue_(post_data=json.dumps(wanted))

    with opened(accept_downloads=True) as context:
        page = context.new_page()
        page.route("**/start", quicker)
        page.goto(server.client.base)
        page.set_input_files("#file", ball)
        page.wait_for_selector("#do-start:enabled", timeout=60_000)
        page.fill("#set-size_mm", str(SIZE))
        page.check("#set-preset-draft")
        paint_the_left_half(page)
        page.click("#do-start")
        page.wait_for_selector(".picture img:visible", timeout=300_000)
        page.wait_for_selector("#result .facts", timeout=300_000)
        until(page, "document.querySelector('#shapes:not([hidden])') !== null")
        page.check("[name=surface][value='2']")
        for shape in ("original", "refined", "compare"):
            page.check(f"[name=shape][value={shape}]")
            page.wait_for_timeout(400)
            assert np.ptp(pixels(page)) > 60
        with page.expect_download() as download:
            page.click("#result .main")
        assert download.value.suggested_filename == "ball-refined.3mf"
        download.value.save_as(tmp_path / "part.3mf")
        assert context.errors == []
    (folder,) = (tmp_path / "workspace" / "jobs").iterdir()
    strokes = json.loads((folder / "regions.json").read_text())["strokes"]
    server.stop()

    vertices, faces, closed = read_3mf(tmp_path / "part.3mf")
    assert closed and len(faces) > 5000
    extent = np.ptp(vertices, axis=0)
    # The size is that of the object; relief of at most a millimetre comes on either side
    assert SIZE - 0.1 < extent.max() < SIZE + 2 and vertices[:, 2].min() == pytest.approx(0, abs=1e-3)
    # Back to the file: the bed is z up, the file y up, and the ball of radius 1 about the origin stands at z = 0
    centred = np.stack([vertices[:, 0], vertices[:, 2] - SIZE / 2, -vertices[:, 1]], axis=1)
    asset = meshes.load(ball)
    relief = distance_to_surface(centred, asset.vertices * SIZE / 2, asset.faces)
    points = centred * 2 / SIZE
    front = points @ np.mean([stroke["normals"][0] for stroke in strokes], axis=0) > 0
    flat = near(points, strokes, -1.0) & front
    assert flat.mean() > 0.1
    assert relief[flat].max() <= 0.02
    assert np.percentile(relief[~near(points, strokes, 5.0)], 90) >= 0.2

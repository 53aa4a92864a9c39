"""The page in a real browser, with a stand-in for the refinement: what a person meets, and what may go wrong."""

from __future__ import annotations

import base64
import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from urllib.parse import quote

import numpy as np
import pytest
from browser import axe_violations, opened, pixels, until
from page_server import Served
from stub_refine import PROGRAM
from textured import checkered_ball
from toys import painted

from genmf_mi.ui import processes


@pytest.fixture(scope="module")
def ball(tmp_path_factory) -> Path:
    return checkered_ball(tmp_path_factory.mktemp("ball") / "ball.glb")


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(processes, "PROGRAM", PROGRAM)
        patch.setattr(processes, "NICE", 0)
        served = Served(tmp_path_factory.mktemp("page") / "workspace")
        yield served.client
        served.stop()


@pytest.fixture(scope="module")
def context(server):
    with opened() as context:
        yield context


@pytest.fixture
def page(context, server):
    page = context.new_page()
    page.goto(server.base)
    page.wait_for_selector("[data-view=empty]")
    yield page
    page.close()
    assert [error for error in context.errors if "Failed to load resource" not in error] == []
    context.errors.clear()


def drop(page, path: Path) -> None:
    """Drop a file onto the page, as a person does."""
    data = page.evaluate_handle(
        "([name, bytes]) => { const all = new DataTransfer();"
        "all.items.add(new File([Uint8Array.from(atob(bytes), (c) => c.charCodeAt(0))], name)); return all; }",
        [path.name, base64.b64encode(path.read_bytes()).decode()],
    )
    page.dispatch_event("main", "drop", {"dataTransfer": data})


def ready(page, path: Path) -> None:
    page.set_input_files("#file", path)
    page.wait_for_selector("#do-start:enabled", timeout=60_000)


def stroke(page) -> None:
    box = page.locator("#canvas").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x - 40, y)
    page.mouse.down()
    page.mouse.move(x + 40, y + 20, steps=6)
    page.mouse.up()


def draft(server, page) -> dict:
    page.wait_for_timeout(700)
    return server.ask("GET", f"jobs/{page.url.partition('#job=')[2]}/draft")[1]


def test_a_dropped_model_is_there_before_the_server_has_it(page, ball):
    page.route("**/api/jobs?name=*", lambda route: None)  # never answered
    drop(page, ball)
    until(page, "performance.getEntriesByName('model-shown').length === 1")
    page.wait_for_timeout(200)
    picture = pixels(page)
    assert np.ptp(picture[len(picture) // 2], axis=0).max() > 100  # yellow and blue
    page.unroute("**/api/jobs?name=*")


def test_settings_and_strokes_survive_a_reload(page, server, ball):
    ready(page, ball)
    page.fill("#set-size_mm", "60")
    page.select_option("#set-printer", "fdm-0.2")
    page.check("#set-stand-on-back")
    page.check("#set-preset-draft")
    assert "60 × 60 × 60 mm, " in page.inner_text("#about").replace("\u202f", " ")
    before = pixels(page)
    page.click("[data-kind=flat]")
    stroke(page)
    page.click("[data-kind=stronger]")
    stroke(page)
    page.mouse.move(5, 5)
    after = pixels(page)
    assert np.abs(after - before).mean() > 1
    page.keyboard.press("Control+z")
    kept = draft(server, page)
    assert kept["settings"] == {"preset": "draft", "size_mm": 60, "printer": "fdm-0.2", "stand": "on-back"}
    (drawn,) = kept["regions"]["strokes"]
    assert drawn["kind"] == "flat" and drawn["radius_mm"] == 4 and len(drawn["points"]) > 3
    radii = np.linalg.norm(np.array(drawn["points"]), axis=1)  # the ball is round about the origin
    assert np.ptp(radii) < 0.02 * radii.max()
    inward = np.einsum("nk,nk->n", drawn["points"] / radii[:, None], drawn["normals"])
    assert (inward > 0.95).all()

    page.reload()
    page.wait_for_selector("#do-start:enabled")
    assert page.input_value("#set-size_mm") == "60" and page.is_checked("#set-stand-on-back")
    assert draft(server, page)["regions"] == kept["regions"]
    page.click("#paint-clear")
    assert draft(server, page)["regions"] is None


def test_a_run_is_followed_through_reloads_and_in_two_tabs(page, server, tmp_path):
    ready(page, Path(painted(tmp_path / "slow.ply")))
    page.click("#do-start")
    page.wait_for_selector("#do-keep:enabled")
    page.reload()
    page.wait_for_selector("#do-keep:enabled")
    until(page, "document.querySelector('.curve path')?.getAttribute('d')?.length > 20")
    other = page.context.new_page()
    other.goto(page.url)
    other.wait_for_selector("#do-cancel:enabled")
    other.click("#do-cancel")
    for tab in (page, other):
        tab.wait_for_selector("#do-continue:enabled")
    other.close()


def test_what_is_wrong_is_said(page, tmp_path):
    (tmp_path / "broken.glb").write_bytes(b"glTF" + bytes(60))
    page.set_input_files("#file", tmp_path / "broken.glb")
    page.wait_for_selector("#about .error")
    assert "broken.glb" in page.inner_text("#about .error")
    assert page.locator("#do-start").is_disabled()
    page.click("#home")
    (tmp_path / "notes.txt").write_text("x")
    page.set_input_files("#file", tmp_path / "notes.txt")
    until(page, "document.querySelector('#drop-error').textContent.includes('no model')")
    with (tmp_path / "huge.glb").open("wb") as file:
        file.truncate(300 << 20)
    page.set_input_files("#file", tmp_path / "huge.glb")
    until(page, "document.querySelector('#drop-error').textContent.includes('256 MB')")


def test_names_are_no_html(page, server, tmp_path):
    name, data = quote("<img src=x onerror=window.evil=1>.ply"), Path(painted(tmp_path / "toy.ply")).read_bytes()
    status, job = server.ask("POST", f"jobs?name={name}", body=data)
    assert status == 201
    page.goto(f"{server.base}/#job={job['id']}")
    page.wait_for_selector("#about h1")
    assert "img src=x" in page.inner_text("#about h1") and page.locator("#about img").count() == 0
    assert page.evaluate("window.evil") is None


def test_delete_can_be_undone(page, tmp_path):
    ready(page, Path(painted(tmp_path / "toy.ply")))
    page.click("#about .link")
    page.wait_for_selector("[data-view=empty]")
    page.click("#toast button")
    page.wait_for_selector("#do-start:enabled")


def test_several_files_are_sent_as_one(page, server, tmp_path):
    (tmp_path / "toy.mtl").write_text("newmtl a\nKd 1 0 0\nnewmtl b\nKd 0 0 1\n")
    ends = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nusemtl a\nf 1 3 2\nf 1 2 4\nusemtl b\nf 1 4 3\nf 2 3 4\n"
    (tmp_path / "toy.obj").write_text("mtllib toy.mtl\n" + ends)
    page.set_input_files("#file", [tmp_path / "toy.obj", tmp_path / "toy.mtl"])
    page.wait_for_selector("#do-start:enabled", timeout=60_000)
    job = server.ask("GET", f"jobs/{page.url.partition('#job=')[2]}")[1]
    assert job["model"] == "toy.obj" and job["analysis"]["model"]["textured"]


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_nobody_is_shut_out(page, ball, scheme):
    page.emulate_media(color_scheme=scheme)
    assert axe_violations(page) == []
    ready(page, ball)
    page.click("[data-kind=stronger]")
    assert axe_violations(page) == []
    page.set_viewport_size({"width": 390, "height": 800})
    assert axe_violations(page) == []
    until(page, "document.documentElement.scrollWidth <= 390", 10)


def test_german_and_keys_alone(page, ball):
    page.select_option("#language", "de")
    until(page, "document.documentElement.lang === 'de'")
    assert "Modell hier ablegen" in page.inner_text("h1")
    ready(page, ball)
    assert page.inner_text("#do-start") == "Starten"
    page.focus("#home")
    reached = set()
    for _ in range(60):
        page.keyboard.press("Tab")
        reached.add(page.evaluate("document.activeElement.id || document.activeElement.dataset.kind"))
    assert {"canvas", "lamp", "language", "set-size_mm", "set-printer", "flat", "do-start"} <= reached
    before = pixels(page)
    page.focus("#canvas")
    page.keyboard.press("ArrowLeft")
    page.wait_for_timeout(200)
    assert np.abs(pixels(page) - before).mean() > 1
    page.select_option("#language", "en")
    until(page, "document.documentElement.lang === 'en'")


def test_a_server_that_was_killed_goes_on(context, tmp_path):
    """kill -9 while a job runs, and the same command again: the page and the process go on."""
    program = (
        "import sys; sys.path.insert(0, sys.argv[1]); import stub_refine; from genmf_mi.ui import processes, server;"
        "processes.PROGRAM, processes.NICE = stub_refine.PROGRAM, 0; server.serve(sys.argv[2], port=int(sys.argv[3]),"
        "browser=False)"
    )
    arguments = [sys.executable, "-c", program, str(Path(__file__).parent), str(tmp_path / "workspace")]

    def started(port: int) -> tuple[subprocess.Popen, str]:
        process = subprocess.Popen([*arguments, str(port)], stdout=subprocess.PIPE, text=True)
        assert process.stdout is not None
        return process, process.stdout.readline().split()[-1]

    first, address = started(0)
    port = int(address.rstrip("/").rpartition(":")[2])
    page = context.new_page()
    try:
        page.goto(address)
        ready(page, Path(painted(tmp_path / "slow.ply")))
        page.click("#do-start")
        page.wait_for_selector("#do-keep:enabled")
        os.kill(first.pid, signal.SIGKILL)
        first.wait()
        page.wait_for_selector("#offline:visible", timeout=30_000)
    finally:
        first.kill()
        first.communicate()
    second, again = started(port)
    try:
        assert again == address
        page.wait_for_selector("#offline", state="hidden", timeout=30_000)
        page.wait_for_selector("#do-keep:enabled")
        page.click("#do-keep")
        page.wait_for_selector("#result h2", timeout=30_000)
        folder = next((tmp_path / "workspace" / "jobs").iterdir())
        assert (folder / "events.jsonl").read_text().count("refining") == 1
        assert json.loads((folder / "job.json").read_text())["state"] == "finished"
    finally:
        page.close()
        second.send_signal(signal.SIGINT)
        second.communicate(timeout=20)
        context.errors.clear()

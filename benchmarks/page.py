"""How quickly the page of ``genmf-mi ui`` answers: a dropped file in a browser, and requests while a job has all cores.

The browser draws on the CPU, as no graphics card is asked for.
"""

from __future__ import annotations

import base64
import http.client
import json
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from benchmarks import record
from benchmarks.inputs import Inputs

ROUNDS, REQUESTS = 5, 200
FLAGS = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox"]
SHOWN = "performance.getEntriesByName('model-shown').length"


def main(inputs: Inputs) -> None:
    """Time the first picture of a GLB of 10 MB after its drop, and requests without and beside a job.

    Args:
        inputs: What all benchmarks have in common; this one reads none of them.
    """
    with tempfile.TemporaryDirectory() as folder, served(Path(folder) / "workspace") as port:
        glb = textured(Path(folder) / "ball.glb")
        found = {"glb_mb": round(glb.stat().st_size / 1e6, 1), "drop_to_picture_ms": dropped(port, glb)}
        for job in ask(port, "GET", "/api/jobs")["jobs"]:
            until_analysed(port, job["id"])
        idle = requests(port)
        job = ask(port, "POST", "/api/samples/strawberry")["id"]
        until_analysed(port, job)
        ask(port, "POST", f"/api/jobs/{job}/start", {"settings": {}})
        with iterating(port, job):
            found["request_ms"] = {"idle": idle, "beside a job": requests(port)}
    print(found)
    record.write("page", found)


def textured(path: Path) -> Path:
    """A ball of 82 000 triangles with a texture of noise: 10 MB."""
    import trimesh
    from PIL import Image

    ball = trimesh.creation.icosphere(6)
    x, y, z = ball.vertices.T
    uv = np.column_stack([np.arctan2(x, z) / (2 * np.pi) + 0.5, np.arcsin(np.clip(y, -1, 1)) / np.pi + 0.5])
    pixels = np.random.default_rng(0).integers(0, 255, (1660, 1660, 3), dtype=np.uint8)
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=Image.fromarray(pixels))
    visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    trimesh.Trimesh(ball.vertices, ball.faces, visual=visual, process=False).export(path)
    return path


def dropped(port: int, glb: Path) -> dict[str, float]:
    """Milliseconds from the drop to the picture, over :data:`ROUNDS` fresh pages."""
    from playwright.sync_api import sync_playwright

    program = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    times = []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=FLAGS)
        for _ in range(ROUNDS):
            page = browser.new_page(viewport={"width": 1280, "height": 860})
            page.goto(f"http://127.0.0.1:{port}/")
            page.wait_for_selector("[data-view=empty]")
            data = page.evaluate_handle(
                "([name, text]) => { const all = new DataTransfer(); const bytes = Uint8Array.from(atob(text), (c) =>"
                " c.charCodeAt(0)); all.items.add(new File([bytes], name)); return all; }",
                [glb.name, base64.b64encode(glb.read_bytes()).decode()],
            )
            page.evaluate("performance.mark('dropped')")
            page.dispatch_event("body", "drop", {"dataTransfer": data})
            while not page.evaluate(SHOWN):
                page.wait_for_timeout(20)
            start, shown = (page.evaluate(f"performance.getEntriesByName('{name}')[0].startTime")
                            for name in ("dropped", "model-shown"))  # fmt: skip
            times.append(shown - start)
            page.close()
        browser.close()
    return summary(times)


def ask(port: int, method: str, path: str, body: dict | None = None) -> dict:
    """The answer of the API."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
    connection.request(method, path, None if body is None else json.dumps(body))
    answer = connection.getresponse()
    content = json.loads(answer.read() or b"{}")
    connection.close()
    if answer.status >= 400:
        raise RuntimeError(f"{method} {path}: {content}")
    return content


def until_analysed(port: int, job: str) -> None:
    """Wait until the server has looked at an uploaded model."""
    while ask(port, "GET", f"/api/jobs/{job}")["analysis"]["state"] not in ("done", "failed"):
        time.sleep(0.2)


@contextmanager
def iterating(port: int, job: str) -> Iterator[None]:
    """Inside, the job runs; it is past its preparation, and is cancelled at the end."""
    while not (found := ask(port, "GET", f"/api/jobs/{job}"))["can_keep"]:
        if found["state"] not in ("queued", "running"):
            raise RuntimeError(f"the job beside which requests are timed is {found['state']}: {found.get('error')}")
        time.sleep(0.5)
    yield
    if (state := ask(port, "GET", f"/api/jobs/{job}")["state"]) != "running":
        raise RuntimeError(f"the job beside which requests are timed is {state} before their end")
    ask(port, "POST", f"/api/jobs/{job}/cancel")


def requests(port: int) -> dict[str, float]:
    """Milliseconds for the page and the list of jobs, each over a connection of its own."""
    times = []
    for i in range(REQUESTS):
        start = time.perf_counter()
        connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
        connection.request("GET", ("/", "/api/jobs")[i % 2])
        connection.getresponse().read()
        connection.close()
        times.append(1000 * (time.perf_counter() - start))
        time.sleep(0.05)
    return summary(times)


def summary(times: list[float]) -> dict[str, float]:
    """Median, 95th percentile and maximum."""
    return {
        "median": round(float(np.median(times)), 1),
        "p95": round(float(np.percentile(times, 95)), 1),
        "max": round(max(times), 1),
    }


@contextmanager
def served(workspace: Path) -> Iterator[int]:
    """The port of a server in a process of its own."""
    command = [sys.executable, "-m", "genmf_mi", "ui", "--no-browser", "--port", "0", "--workspace", str(workspace)]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert server.stdout is not None
    try:
        yield int(server.stdout.readline().rstrip().rstrip("/").rpartition(":")[2])
    finally:
        server.terminate()
        server.wait()

"""The examples of docs/http_api.md do what they say."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from textured import checkered_ball

from genmf_mi.ui.app import Api
from genmf_mi.ui.workspace import Workspace

PAGE = (Path(__file__).parents[2] / "docs" / "http_api.md").read_text(encoding="utf-8")


@pytest.mark.usefixtures("stub")
def test_the_script_runs(client, tmp_path):
    if shutil.which("curl") is None:
        pytest.skip("there is no curl")
    (script,) = re.findall(r"```sh\n(.*?)```", PAGE, re.S)
    checkered_ball(tmp_path / "ball.glb")
    done = subprocess.run(
        ["bash", "-eu", "-c", script], cwd=tmp_path, env={"GENMF": client.base, "PATH": "/usr/bin:/bin"}, timeout=120,
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "part.3mf").read_text() == "refined.3mf of ball"
    assert json.loads((tmp_path / "metrics.json").read_text()) == {"interrupted": False}
    assert json.loads((tmp_path / "job.json").read_text())["settings"]["size_mm"] == 80


def test_every_address_is_there(tmp_path):
    """All of the API in the table, and nothing else."""
    table = PAGE.split("## Addresses")[1].split("\n## ")[0]
    told = set()
    for cell in re.findall(r"^\| (`.*?) \|", table, re.M):
        (path,) = set(re.findall(r"/api[\w/.]*", cell.partition("POST /api/jobs/ID/restore")[0]))
        methods = re.findall(r"\b(GET|PUT|POST|DELETE)\b", cell.partition(", `POST /api/jobs/ID/restore")[0])
        told |= {(method, path) for method in methods}
        if "restore" in cell:
            told.add(("POST", "/api/jobs/ID/restore"))
    there = {
        (method, re.sub(r"\{(\w+)\}", lambda m: m[1].upper(), route.path))
        for route in Api(Workspace(tmp_path)).routes()
        for method in route.methods or ()
        if route.path.startswith("/api") and method != "HEAD"
    }
    assert told == there

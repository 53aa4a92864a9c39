"""What becomes of jobs, with a stand-in for the refinement: the queue, the ways to end, restarts of the server."""

from __future__ import annotations

import json
import os
import signal
import time

import pytest
from page_server import Served
from toys import painted

from genmf_mi.core.errors import OutputError
from genmf_mi.ui import processes
from genmf_mi.ui.workspace import Job, Workspace

pytestmark = pytest.mark.usefixtures("stub")


@pytest.fixture
def job(client, tmp_path):
    return client.upload(painted(tmp_path / "toy.ply"), wait=False)


def named(client, tmp_path, name: str) -> dict:
    return client.upload(painted(tmp_path / f"{name}.ply"), wait=False)


def words(client, job: dict) -> list[str]:
    return json.loads((client.workspace / "jobs" / job["id"] / "run" / "words.json").read_text())


def test_a_job_runs_and_its_files_are_there(client, job):
    assert client.start(job, preset="draft", size_mm=80)["state"] in ("queued", "running")
    done = client.wait(job["id"], "finished")
    assert not done["kept"] and not done["can_continue"]
    assert {"refined.3mf", "refined.stl", "report.html", "metrics.json"} <= set(done["files"])
    said = words(client, job)
    assert said[1:3] == ["refine", "toy.ply"] and said[said.index("--size-mm") + 1] == "80.0" and "--force" in said
    status, headers, body = client.raw("GET", f"/api/jobs/{job['id']}/files/refined.3mf?download")
    assert status == 200 and body == b"refined.3mf of toy" and headers["content-type"] == "model/3mf"
    assert 'filename="toy-refined.3mf"' in headers["content-disposition"]
    report = client.raw("GET", f"/api/jobs/{job['id']}/files/report.html")[1]
    assert report["content-security-policy"].startswith("sandbox allow-scripts;")
    assert client.ask("POST", f"jobs/{job['id']}/start", {})[0] == 409


def test_regions_reach_the_process(client, job):
    stroke = {"kind": "flat", "points": [[0, 0, 1]], "normals": [[0, 0, 1]], "radius_mm": 4.0}
    regions = {"format": "genmf-regions", "version": 1, "strokes": [stroke]}
    status, _ = client.ask("POST", f"jobs/{job['id']}/start", {"settings": {}, "regions": regions})
    assert status == 200
    client.wait(job["id"], "finished")
    said = words(client, job)
    with open(said[said.index("--regions") + 1]) as file:
        assert json.load(file) == regions


def test_one_after_the_other(client, tmp_path):
    slow, waiting, last = (named(client, tmp_path, name) for name in ("slow", "second", "third"))
    for job in (slow, waiting, last):
        client.start(job)
    client.wait(slow["id"], lambda job: job["can_keep"])
    assert [client.ask("GET", f"jobs/{each['id']}")[1]["state"] for each in (waiting, last)] == ["queued", "queued"]
    assert client.ask("POST", f"jobs/{waiting['id']}/cancel")[1]["state"] == "ready"
    assert client.ask("POST", f"jobs/{slow['id']}/cancel")[0] == 200
    assert client.wait(slow["id"], "cancelled")["can_continue"]
    client.wait(last["id"], "finished")
    assert client.ask("GET", f"jobs/{waiting['id']}")[1]["state"] == "ready"


def test_keep_what_there_is_and_continue(client, tmp_path):
    job = named(client, tmp_path, "slow")
    client.start(job)
    client.wait(job["id"], lambda job: job["can_keep"])
    assert client.ask("POST", f"jobs/{job['id']}/keep")[1]["stopping"]
    kept = client.wait(job["id"], "finished")
    assert kept["kept"] and kept["can_continue"] and not kept["stopping"]
    assert client.ask("POST", f"jobs/{job['id']}/resume")[0] == 200
    client.wait(job["id"], lambda job: job["can_keep"])
    assert client.ask("POST", f"jobs/{job['id']}/cancel")[0] == 200
    client.wait(job["id"], "cancelled")
    assert "--resume" in words(client, job)


def test_failures_are_told_and_can_be_continued(client, tmp_path):
    broken = named(client, tmp_path, "fails")
    client.start(broken)
    assert client.wait(broken["id"], "failed")["error"] == "this one is broken. Export it again."
    dying = named(client, tmp_path, "dies")
    client.start(dying)
    failed = client.wait(dying["id"], "failed")
    assert "want of memory" in failed["error"] and failed["can_continue"]
    assert client.ask("POST", f"jobs/{dying['id']}/resume")[0] == 200
    client.wait(dying["id"], "finished")


def test_a_copy_can_be_changed_and_a_deleted_job_comes_back(client, job):
    draft = {"settings": {"size_mm": 50}, "regions": None}
    assert client.ask("PUT", f"jobs/{job['id']}/draft", draft)[0] == 204
    status, copy = client.ask("POST", f"jobs/{job['id']}/copy")
    assert status == 201 and copy["id"] != job["id"] and copy["state"] == "ready"
    assert client.ask("GET", f"jobs/{copy['id']}/draft")[1] == draft
    assert client.ask("DELETE", f"jobs/{job['id']}")[0] == 204
    assert [each["id"] for each in client.ask("GET", "jobs")[1]["jobs"]] == [copy["id"]]
    assert client.ask("GET", f"jobs/{job['id']}")[0] == 404
    assert client.ask("POST", f"jobs/{job['id']}/restore")[0] == 200
    assert len(client.ask("GET", "jobs")[1]["jobs"]) == 2


def test_events_are_taken_up_where_they_were_lost(client, job):
    client.start(job)
    client.wait(job["id"], "finished")

    def read(last: str | None) -> str:
        import http.client

        connection = http.client.HTTPConnection("127.0.0.1", client.port, timeout=20)
        connection.request("GET", f"/api/jobs/{job['id']}/events", headers={"Last-Event-ID": last} if last else {})
        answer, text = connection.getresponse(), ""
        assert answer.getheader("content-type").startswith("text/event-stream")
        while "event: job" not in text:
            text += answer.read1(1000).decode()
        connection.close()
        return text

    text = read(None)
    lines = json.loads(next(line[6:] for line in text.splitlines() if line.startswith("data: [")))
    assert lines[0]["stage"] == "refining" and [line["done"] for line in lines[1:]] == [1, 2, 3, 4, 5, 6]
    last = [line[4:] for line in text.splitlines() if line.startswith("id: ")][-1]
    assert "event: progress" not in read(last)


def test_refusals(client, job):
    assert client.ask("GET", "jobs/20260101-000000-00000000")[0] == 404
    for what, status in (("cancel", 409), ("keep", 409), ("resume", 409)):
        assert client.ask("POST", f"jobs/{job['id']}/{what}")[0] == status
    assert client.ask("POST", f"jobs/{job['id']}/start", {"settings": {"size_mm": -3}})[1]["error"] == {
        "code": "setting",
        "message": "size-mm is the longest side of the part and must be positive, not -3.",
    }
    assert client.ask("POST", f"jobs/{job['id']}/start", body=b"{nonsense")[1]["error"]["code"] == "setting"
    assert client.ask("POST", f"jobs/{job['id']}/start", {"regions": {"strokes": 1}})[0] == 422
    assert client.ask("POST", "samples/nothing")[0] == 404 == client.ask("POST", "samples/..%2f..")[0]
    assert client.ask("GET", f"jobs/{job['id']}")[1]["state"] == "ready"


class TestRestart:
    def test_the_process_goes_on_and_is_found_again(self, tmp_path):
        first = Served(tmp_path / "workspace")
        job = named(first.client, tmp_path, "slow")
        first.client.start(job)
        first.client.wait(job["id"], lambda job: job["can_keep"])
        first.stop()
        second = Served(tmp_path / "workspace")
        assert second.client.ask("GET", f"jobs/{job['id']}")[1]["state"] == "running"
        second.client.ask("POST", f"jobs/{job['id']}/keep")
        assert second.client.wait(job["id"], "finished")["kept"]
        said = (tmp_path / "workspace" / "jobs" / job["id"] / "events.jsonl").read_text()
        assert said.count("refining") == 1  # never started again
        second.stop()

    def test_it_ended_meanwhile(self, tmp_path):
        first = Served(tmp_path / "workspace")
        done, killed = named(first.client, tmp_path, "toy"), named(first.client, tmp_path, "slow")
        first.client.start(done)
        first.client.wait(done["id"], "running")
        first.stop()
        folder = tmp_path / "workspace" / "jobs" / done["id"]
        while processes.is_locked(folder):
            time.sleep(0.05)
        second = Served(tmp_path / "workspace")
        assert second.client.wait(done["id"], "finished")["files"]
        second.client.start(killed)
        second.client.wait(killed["id"], lambda job: job["can_keep"])
        second.stop()
        workspace = Workspace(tmp_path / "workspace")
        found = workspace.get(killed["id"])
        assert found is not None
        os.killpg(found.pid, signal.SIGKILL)
        while processes.is_locked(workspace.folder(found)):
            time.sleep(0.05)
        third = Served(tmp_path / "workspace")
        third.client.wait(killed["id"], lambda job: job["state"] == "running" and job["can_keep"])
        assert "--resume" in words(third.client, killed)
        third.client.ask("POST", f"jobs/{killed['id']}/cancel")
        third.client.wait(killed["id"], "cancelled")
        third.stop()


def test_half_an_upload_is_swept_and_a_workspace_has_one_server(tmp_path):
    workspace = Workspace(tmp_path)
    _, half = workspace.new_folder()
    identifier, _ = workspace.new_folder()
    workspace.save(Job(identifier, "toy", "toy.ply", 0.0, deleted=5.0))
    workspace.purge(now=100.0)
    assert not half.exists() and workspace.get(identifier)
    workspace.purge(now=1e9)
    assert workspace.get(identifier) is None
    with workspace.locked(), pytest.raises(OutputError, match="another server"), Workspace(tmp_path).locked():
        pass

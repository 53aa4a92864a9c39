"""A Ray cluster of this machine: workers and the driver are killed, and every item is there once in the end."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from benchmarks.batch_faults import Cluster, counted, drill, processes
from genmf_mi.batch.ray_executor import RayExecutor, absolute
from genmf_mi.batch.task import Limits, Task
from genmf_mi.batch.work import Work
from genmf_mi.cli import main as cli
from genmf_mi.core.errors import SetupError

pytestmark = [
    pytest.mark.skipif(sys.platform != "linux", reason="processes are found in /proc"),
    pytest.mark.skipif(importlib.util.find_spec("ray") is None, reason="Ray is not installed: pip install ray"),
]

DRIVER = """
import sys
from dataclasses import replace
sys.path.insert(0, {folder!r})
import genmf_mi
from genmf_mi.batch.ray_executor import RayExecutor
from toy_batches import CONFIG, TOY_WORKER
limits = genmf_mi.Limits(memory_gb=0.5, crashes=10)
config = replace(CONFIG, iterations=40)
executor = RayExecutor({address!r}, 1, limits, config, command=TOY_WORKER)
sys.exit(sum(not one.good for one in genmf_mi.run_batch({items!r}, config, executor=executor)))
"""


def test_killed_workers_and_a_killed_driver_lose_nothing(assets):
    items, mark = assets(*(f"slow{i}" for i in range(6)), "bad"), f"test-{id(assets)}"
    with Cluster(mark, port=0) as cluster:
        code = DRIVER.format(folder=str(Path(__file__).parent), items=items, address=cluster.address)

        def victim(line: str) -> bool:
            return "toy_worker" in line or line.startswith("ray::_attended")

        killed = drill(Path("runs"), [[sys.executable, "-c", code]], 2, mark, victim=victim, moments=(0.5, 1.5))
    assert killed["exit_codes"] == [1] and killed["drivers_killed"] == 1
    result = counted(Path("runs"), 7)
    assert result["outcomes"] == 7 and result["complete"] == 6
    assert result["refined_twice"] == 0 and result["left_unfinished"] == 0
    assert processes(mark) == []


@pytest.mark.usefixtures("workplace")
def test_no_cluster_is_said_before_the_work():
    """In a process of its own, as Ray leaves threads behind."""
    command = [sys.executable, "-m", "genmf_mi", "batch", "ball", "--engine", "ray", "--address", "127.0.0.1:1"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2 and "no Ray cluster answers at 127.0.0.1:1" in done.stderr.splitlines()[-1]
    assert not Path("runs").exists()


def test_a_lost_node_ends_the_batch_and_blames_no_item():
    """No outcome is made of the items that were under way."""
    from ray.exceptions import LocalRayletDiedError

    def lost(_):
        raise LocalRayletDiedError

    executor = object.__new__(RayExecutor)
    executor.address, executor.threads, executor.limits, executor.command = "auto", 1, Limits(), None
    executor._pending, executor._task = {}, SimpleNamespace(remote=lambda task, *_: task.name)
    executor._ray = SimpleNamespace(wait=lambda all, **_: (all[:1], all[1:]), get=lost)
    tasks = iter([Task(name, name, Work(), f"runs/{name}") for name in ("one", "two")])
    with pytest.raises(SetupError, match="what is finished is kept"):
        list(executor.run(tasks))


def test_without_ray(monkeypatch, workplace, capsys):
    monkeypatch.setitem(sys.modules, "ray", None)
    assert cli.main(["batch", "ball", "--engine", "ray"]) == 2
    assert "pip install 'genmf-mi[ray]'" in capsys.readouterr().err


def test_paths_mean_the_same_on_other_nodes(workplace):
    work = Work(textured="a.glb", scene="s3://b/scene.xml", references=("front.png@0,10",))
    task = absolute(Task("ball", "ball", work, "runs/ball"))
    here = str(workplace)
    assert task.asset == "ball" and task.folder == f"{here}/runs/ball" and task.work.textured == f"{here}/a.glb"
    assert task.work.scene == "s3://b/scene.xml" and task.work.references == (f"{here}/front.png@0,10",)
    assert absolute(Task("x", "x.glb", work, "gs://b/x")).asset == f"{here}/x.glb"

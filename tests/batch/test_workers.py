"""Workers in processes of their own: what they survive, and what is stopped."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import pytest
from toy_batches import CONFIG, local, starts

import genmf_mi
from genmf_mi.batch import supervisor
from genmf_mi.batch.executors import LocalExecutor, _share, default_workers
from genmf_mi.batch.journal import BatchOutcome
from genmf_mi.batch.supervisor import Share
from genmf_mi.core import memory
from genmf_mi.core.errors import ConfigError


@pytest.fixture(autouse=True)
def _no_pauses(monkeypatch):
    monkeypatch.setattr(supervisor, "PAUSE", 0.0)


def run(items: list[str], executor: LocalExecutor, **options) -> dict[str, BatchOutcome]:
    return {one.name: one for one in genmf_mi.run_batch(items, CONFIG, executor=executor, **options)}


def pids(folder: str = "runs") -> list[int]:
    return [int(line.split()[2]) for line in Path(folder, "starts.txt").read_text().splitlines()]


def alive(pid: int) -> bool:
    return Path(f"/proc/{pid}").exists() and "Z" not in Path(f"/proc/{pid}/stat").read_text().split()[2]


def test_a_crash_costs_its_item_alone_and_goes_on_from_the_checkpoint(assets):
    """And one that always crashes is put aside, until it is asked for again."""
    paths = assets("one", "once", "crash", "two", "flaky")
    outcomes = run(paths, local())
    assert {name: one.state for name, one in outcomes.items()} == {
        "one": "refined", "once": "refined", "crash": "quarantined", "two": "refined", "flaky": "refined"}  # fmt: skip
    tried = starts()
    assert [first for name, first in tried if name == "once"] == [0, 2] and outcomes["once"].attempts == 2
    assert [first for name, first in tried if name == "crash"] == [0, 2, 2]
    assert "3 crashes" in outcomes["crash"].error and "SIGKILL" in outcomes["crash"].error
    assert outcomes["flaky"].attempts == 2 and outcomes["one"].peak_memory_gb > 0.01
    again = run(paths, local())
    assert again["crash"].state == "quarantined" and again["one"].state == "skipped" and len(starts()) == len(tried)
    assert run(paths, local(crashes=2), retry_failed=True)["crash"].state == "quarantined"
    assert [name for name, _ in starts()[len(tried) :]] == ["crash", "crash"]


def test_crash_of_a_run_that_replaces_another(assets):
    """The old one is not taken for the new one, and is kept until that is complete."""
    (path,) = assets("once")
    run([path], local(1))
    before = Path("runs/once/metrics.json").read_text()
    Path("runs/once/seen").unlink()
    outcome = run([path], local(1), force=True)["once"]
    assert outcome.state == "refined" and [first for _, first in starts()] == [0, 2, 0, 2]
    assert Path("runs/once/metrics.json").read_text() == before and not Path("runs/once/.replacement").exists()


def test_limits_of_time_and_memory(assets):
    outcomes = run(assets("hang"), local(1, seconds=1.0)) | run(assets("fat", "one"), local(1, memory_gb=0.8))
    assert {name: one.cause for name, one in outcomes.items()} == {"hang": "time", "fat": "memory", "one": ""}
    assert "--time-limit-s" in outcomes["hang"].error and "--memory-gb" in outcomes["fat"].error
    assert not any(map(alive, pids()))


def test_workers_stay_warm_and_are_replaced(assets):
    paths = assets(*"abcde")
    run(paths[:3], local(1), out="warm")
    assert len(set(pids("warm"))) == 1
    run(paths, local(1, items=2), out="replaced")
    assert len(set(pids("replaced"))) == 3


def test_caller_that_stops_leaves_no_worker(assets):
    running = genmf_mi.run_batch(assets("one", "hang", "slow"), CONFIG, executor=local())
    assert next(running).name == "one"
    running.close()
    assert not any(map(alive, pids()))


DRIVER = """
import sys
sys.path.insert(0, {folder!r})
import genmf_mi
from toy_batches import CONFIG, local
for outcome in genmf_mi.run_batch({items!r}, CONFIG, executor=local({workers})):
    print(outcome.name, outcome.state, flush=True)
"""


def test_killed_driver_leaves_no_worker_and_loses_nothing(assets):
    items = assets("one", "slow1", "hang", "two")
    code = DRIVER.format(folder=str(Path(__file__).parent), items=items, workers=2)
    driver = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert driver.stdout is not None
    seen = [driver.stdout.readline().split()[0] for _ in range(2)]
    driver.kill()
    driver.wait()
    driver.stdout.close()
    deadline = time.monotonic() + 20
    while any(map(alive, pids())) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not any(map(alive, pids()))
    outcomes = run(items, local(1, seconds=2.0))
    assert all(outcomes[name].state == "skipped" for name in seen)
    assert {name for name, one in outcomes.items() if one.good} == {"one", "slow1", "two"}
    assert outcomes["hang"].cause == "time"


def test_worker_that_cannot_start(assets):
    broken = LocalExecutor(1, 1, genmf_mi.Limits(crashes=1), CONFIG, (sys.executable, "-c", "raise SystemExit('no')"))
    outcome = run(assets("one"), broken)["one"]
    assert outcome.state == "quarantined" and "exit code 1: no" in outcome.error


def test_shares_of_the_machine(monkeypatch):
    assert [_share(i, 2, 2, [0, 1, 4, 5], 0).cores for i in range(2)] == [(0, 1), (4, 5)]
    assert _share(0, 3, 1, [0, 1], 0).cores == ()  # fewer cores than workers: nobody is pinned
    assert [_share(i, 4, 1, [0, 1, 2, 3], 2).gpu for i in range(4)] == [0, 1, 0, 1]
    environment = Share(2, (3, 4), 1).environment()
    assert environment["OMP_NUM_THREADS"] == "2" and environment["CUDA_VISIBLE_DEVICES"] == "1"
    monkeypatch.setattr("genmf_mi.batch.executors.cores", lambda: list(range(8)))
    monkeypatch.setattr(memory, "available_gb", lambda: 4.0)
    monkeypatch.setattr("genmf_mi.batch.executors.gpus", lambda: 0)
    assert default_workers(genmf_mi.RefineConfig(), 1) == 2
    assert default_workers(CONFIG, 1) == 2 and default_workers(CONFIG, 4) == 2
    monkeypatch.setattr("genmf_mi.batch.executors.gpus", lambda: 4)
    assert default_workers(genmf_mi.RefineConfig(), 1) == 4 and default_workers(CONFIG, 1) == 2
    with pytest.raises(ConfigError, match="cannot be negative"):
        LocalExecutor(-1)
    with pytest.raises(ConfigError, match="seconds cannot be"):
        genmf_mi.Limits(seconds=-1.0)

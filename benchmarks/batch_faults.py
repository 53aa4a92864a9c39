"""Whether a batch is complete however it is killed: workers and the driver end by SIGKILL at random moments.

Small drafts of spheres with painted stripes, on a Ray cluster of this machine, in local workers, and in four shards.
"""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import trimesh

from benchmarks import record
from benchmarks.inputs import Inputs
from genmf_mi.batch import journal
from genmf_mi.pipeline.run_folder import CHECKPOINT, METRICS

MARK = "GENMF_DRILL"
"""Environment variable by which a drill knows its own processes from those of others."""
RUNS = Path("runs/benchmarks/batch_faults")
SMALL = "--preset draft --iterations 30 --resolution 96 --max-faces 4000 --samples 1 --device cpu"


def main(inputs: Inputs, *, items: int = 24, kills: int = 5, engines: str = "ray,local,shards", seed: int = 0) -> None:
    """Kill workers and the driver of a batch, start the driver again, and look at what is there in the end.

    Args:
        inputs: What all benchmarks have in common; this one reads none of them.
        items: Assets of each batch.
        kills: Workers killed in each; the driver is killed once more.
        engines: Which of ray, local and shards, with commas between.
        seed: Of the moments and the victims.
    """
    shutil.rmtree(RUNS, ignore_errors=True)
    manifest = write_assets(RUNS / "assets", items)
    results = {}
    for engine in engines.split(","):
        out, mark = RUNS / engine, f"{os.getpid()}-{engine}"
        command = [sys.executable, "-m", "genmf_mi", "batch", str(manifest), "--out", str(out), f"--arguments={SMALL}"]
        command += ["--crashes", str(kills + 1)]  # all of them may hit one item, which is not to blame
        start = time.monotonic()
        if engine == "ray":
            with Cluster(mark) as cluster:
                command += ["--engine", "ray", "--address", cluster.address, "--memory-gb", "1.5"]
                results[engine] = drill(out, [command], kills, mark, seed)
        elif engine == "local":
            results[engine] = drill(out, [[*command, "--workers", "2", "--threads", "1"]], kills, mark, seed)
        else:
            shards = [[*command, "--workers", "1", "--threads", "1", "--shard", f"{i}/4"] for i in range(1, 5)]
            results[engine] = drill(out, shards, kills, mark, seed)
        results[engine] |= {"wall_seconds": round(time.monotonic() - start), **counted(out, items)}
        print(engine, json.dumps(results[engine]), flush=True)
    record.write_entry(
        "batch", "faults", {"machine": record.machine()} | {"items": items, "settings": SMALL, "engines": results}
    )


def write_assets(folder: Path, count: int, subdivisions: int = 3) -> Path:
    """Spheres with stripes, each other ones, and a manifest of them."""
    folder.mkdir(parents=True)
    for i in range(count):
        ball = trimesh.creation.icosphere(subdivisions, radius=1 + 0.01 * i)  # the same content would be the same item
        bright = np.sin((5 + 0.3 * i) * ball.vertices[:, 1]) > 0
        ball.visual.vertex_colors = np.where(bright[:, None], (220, 120, 120, 255), (60, 60, 60, 255)).astype(np.uint8)
        ball.export(folder / f"ball{i:02}.ply")
    manifest = folder / "list.csv"
    manifest.write_text("asset\n" + "".join(f"ball{i:02}.ply\n" for i in range(count)), encoding="utf-8")
    return manifest


def is_worker(line: str) -> bool:
    """Whether a command line is of a worker of ours or of Ray; with an agent, Ray ends its whole node."""
    return "genmf_mi.batch.worker" in line or (line.startswith("ray::") and not line.endswith("Agent"))


def drill(
    out: Path,
    commands: Sequence[Sequence[str]],
    kills: int,
    mark: str,
    seed: int = 0,
    victim: Callable[[str], bool] = is_worker,
    moments: tuple[float, float] = (2.0, 12.0),
) -> dict:
    """Run batches, kill ``kills`` of their workers and, halfway, a driver, which is started again.

    Args:
        out: where the batches write; nobody is killed before the first item has begun. commands: of the drivers.
        mark: of their processes. victim: says of a command line whether it is a worker.
        moments: seconds between two kills, at least and at most.

    Returns:
        how many workers and drivers were killed, and the exit codes of the last drivers.
    """
    chance, own = random.Random(seed), environment(mark)
    drivers = [subprocess.Popen(command, env=own, stdout=subprocess.DEVNULL) for command in commands]
    killed = {"workers_killed": 0, "drivers_killed": 0}
    while killed["workers_killed"] < kills and any(driver.poll() is None for driver in drivers):
        time.sleep(chance.uniform(*moments))
        if not any(out.glob("*/item.json")):
            continue
        if killed["workers_killed"] >= kills // 2 and not killed["drivers_killed"]:
            index = next((i for i, driver in enumerate(drivers) if driver.poll() is None), None)
            if index is None:
                break
            drivers[index].kill()
            drivers[index].wait()
            killed["drivers_killed"] += 1
            drivers[index] = subprocess.Popen(commands[index], env=own, stdout=subprocess.DEVNULL)
        elif workers := sorted(pid for pid, line in processes(mark) if victim(line)):
            os.kill(chance.choice(workers), signal.SIGKILL)
            killed["workers_killed"] += 1
    return {**killed, "exit_codes": [driver.wait() for driver in drivers]}


def counted(out: Path, items: int) -> dict:
    """What a batch has left: every item once."""
    records = [line for line in journal.read(str(out)) if "name" in line]
    refined = [line["name"] for line in records if line["state"] == "refined"]
    complete = [name for name in {*refined} if (out / name / METRICS).exists()]
    latest = journal.latest(records)
    return {
        "outcomes": len(latest),
        "complete": sum(one.complete for one in latest.values()),
        "refined_twice": len(refined) - len(set(refined)),
        "lost": items - len({one for one in latest if latest[one].complete}),
        "left_unfinished": sum(1 for _ in out.glob(f"*/{CHECKPOINT}")),
        "folders_complete": len(complete),
        "started_again": sum(one.attempts > 1 for one in latest.values()),
    }


def environment(mark: str) -> dict[str, str]:
    """Of the processes of a drill; with it, Ray stays on the loopback interface, and its workers, nice by default, get
    their share of a busy machine."""
    ray = {"USAGE_STATS_ENABLED": "0", "ENABLE_WINDOWS_OR_OSX_CLUSTER": "0", "worker_niceness": "0"}
    return {**os.environ, MARK: mark, **{f"RAY_{name}": value for name, value in ray.items()}}


def processes(mark: str) -> list[tuple[int, str]]:
    """Numbers and command lines of the processes that a drill has started, this one aside (Linux)."""
    found = []
    for folder in Path("/proc").iterdir():
        if not folder.name.isdigit() or int(folder.name) == os.getpid():
            continue
        try:
            if f"{MARK}={mark}\0".encode() in (folder / "environ").read_bytes() + b"\0":
                line = (folder / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace").strip()
                found.append((int(folder.name), line))
        except OSError:  # it has ended, or is somebody else's
            continue
    return found


class Cluster:
    """A Ray cluster of this machine: a head with two CPUs, which hears nothing from outside and tells nobody."""

    def __init__(self, mark: str, port: int = 0) -> None:
        self._mark, self._port = mark, port or free_port()
        self.address = f"127.0.0.1:{self._port}"

    def __enter__(self) -> Cluster:
        self._folder = tempfile.TemporaryDirectory(prefix="ray-", dir="/tmp", ignore_cleanup_errors=True)
        command = [
            sys.executable, "-m", "ray.scripts.scripts", "start", "--head", "--block", "--disable-usage-stats",
            f"--port={self._port}", "--node-ip-address=127.0.0.1", "--num-cpus=2", "--num-gpus=0",
            "--memory=6000000000", "--object-store-memory=100000000", "--include-dashboard=false",
            f"--temp-dir={self._folder.name}",
        ]  # fmt: skip
        self._log = Path(self._folder.name, "start.log").open("w+")
        self._head = subprocess.Popen(command, env=environment(self._mark), stdout=self._log, stderr=self._log)
        deadline = time.monotonic() + 120
        while "Ray runtime started" not in Path(self._log.name).read_text(encoding="utf-8"):
            if self._head.poll() is not None or time.monotonic() > deadline:
                self.__exit__()
                raise RuntimeError(f"no Ray cluster: {Path(self._log.name).read_text(encoding='utf-8')}")
            time.sleep(0.2)
        return self

    def __exit__(self, *_: object) -> None:
        self._head.kill()
        self._head.wait()
        for _again in range(50):
            left = processes(self._mark)
            for pid, _line in left:
                try:
                    os.kill(pid, signal.SIGKILL)
                except ProcessLookupError:
                    continue
            if not left:
                break
            time.sleep(0.1)
        self._log.close()
        self._folder.cleanup()


def free_port() -> int:
    """A port of this machine that nobody listens at."""
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]

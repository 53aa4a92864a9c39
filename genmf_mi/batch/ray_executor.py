"""Items as tasks on a Ray cluster: ``pip install 'genmf-mi[ray]'``, https://docs.ray.io/en/latest/ray-core/tasks.html.

A task is a supervisor in a Ray worker, with a warm worker process of ours beneath it, as on one machine; so limits,
crashes and retries are the same everywhere. Ray itself starts a task again whose worker or node has died
(``max_retries``). A driver that is killed takes its tasks with it; started again, it goes on from what is on disk.
"""

from __future__ import annotations

import os
import socket
import threading
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from genmf_mi.batch import storage
from genmf_mi.batch.executors import TICK, worker_gb
from genmf_mi.batch.journal import BatchOutcome
from genmf_mi.batch.keys import is_sample
from genmf_mi.batch.supervisor import Share, Supervisor
from genmf_mi.batch.task import Limits, Task
from genmf_mi.core.config import RefineConfig
from genmf_mi.core.errors import ConfigError, SetupError

if TYPE_CHECKING:
    pass

IN_FLIGHT, IN_FLIGHT_IN_MEMORY = 1000, 32
"""Tasks that are handed to Ray at a time, so that it knows how many nodes are wanted; fewer of assets that travel with
their task."""
IDLE = 10.0
"""Seconds after which the worker process beneath an idle Ray worker is ended: its memory is no longer accounted for."""
ANSWER = 20.0
"""Seconds in which a cluster must accept a connection."""
SUPERVISOR_GB = 0.3
"""Memory of a Ray worker without the process beneath it."""


@dataclass
class RayExecutor:
    """Tasks on the Ray cluster at ``address``: ``auto`` for the one that this machine belongs to, ``host:port``, or
    ``ray://host:port`` from outside.

    threads: CPUs of a task, 0 for one. gpus: of a task; None for one if the cluster has any and the settings allow it.
    command: that starts a worker, None for the usual one.

    Raises:
        SetupError: Ray is not installed, or no cluster answers. ConfigError: no node is large enough.
    """

    address: str = "auto"
    threads: int = 0
    limits: Limits = field(default_factory=Limits)
    config: RefineConfig = field(default_factory=RefineConfig)
    gpus: float | None = None
    command: Sequence[str] | None = None

    def __post_init__(self) -> None:
        self._ray = _connected(self.address)
        threads, resources = self.threads or 1, self._ray.cluster_resources()
        if self.gpus is None:
            self.gpus = 1.0 if self.config.device != "cpu" and resources.get("GPU", 0) >= 1 else 0.0
        needed = (self.limits.memory_gb or worker_gb(self.config)) + SUPERVISOR_GB
        for what, wanted, largest in (
            ("CPUs", threads, self._largest("CPU")),
            ("GB of memory", needed, self._largest("memory") / 1e9),
            ("GPUs", self.gpus, self._largest("GPU")),
        ):
            if wanted > largest and resources:
                raise ConfigError(
                    f"a task needs {wanted:g} {what}, and no node of the cluster has more than {largest:.1f}. "
                    "Lower --threads or --memory-gb, or start larger nodes."
                )
        self._task = self._ray.remote(
            num_cpus=threads,
            num_gpus=self.gpus,
            memory=int(needed * 1e9),
            max_retries=self.limits.crashes,
            retry_exceptions=False,
        )(_attended)
        self._pending: dict[Any, Task] = {}

    def _largest(self, resource: str) -> float:
        nodes = [node for node in self._ray.nodes() if node.get("Alive")]
        return max((node.get("Resources", {}).get(resource, 0.0) for node in nodes), default=0.0)

    def run(self, tasks: Iterator[Task]) -> Iterator[BatchOutcome | None]:
        from ray.exceptions import LocalRayletDiedError, RayError

        more, pending = True, self._pending
        while more or pending:
            waiting = None
            while more and len(pending) < IN_FLIGHT:
                waiting = next(tasks, None)
                more = waiting is not None
                if waiting is None:
                    break
                reference = self._task.remote(absolute(waiting), self.limits, self.threads or 1, self.command)
                pending[reference] = waiting
                if not isinstance(waiting.asset, str) and len(pending) >= IN_FLIGHT_IN_MEMORY:
                    break
            if not pending:
                return
            done, _ = self._ray.wait(list(pending), num_returns=1, timeout=TICK)
            for reference in done:
                task = pending.pop(reference)
                try:
                    outcome: BatchOutcome = self._ray.get(reference)
                    yield replace(outcome, asset=task.asset_name, folder=task.folder)
                except LocalRayletDiedError:
                    raise SetupError(
                        f"this node is no longer part of the Ray cluster at {self.address}. Start it again, and then "
                        "the same command: what is finished is kept."
                    ) from None
                except RayError as error:  # its worker or node died more often than Ray tries
                    text = " ".join(str(error).split())[:300]
                    yield task.outcome("failed", cause="crash", error=f"{type(error).__name__}: {text}")
            if not done:
                yield None

    def memory_gb(self) -> float:
        return 0.0

    def close(self) -> None:
        for reference in self._pending:
            self._ray.cancel(reference, force=True)
        self._pending.clear()
        self._ray.shutdown()


def _connected(address: str) -> Any:
    """The module ``ray``, connected. Raises :class:`SetupError`."""
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    # Ray would hide the GPUs from tasks that ask for none; which is as we want it, and said so
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    try:
        import ray
    except ImportError as error:
        raise SetupError("Ray is not installed: pip install 'genmf-mi[ray]'.") from error
    if ray.is_initialized():
        return ray
    try:
        _require_answer(address)
        ray.init(address=address, log_to_driver=False, configure_logging=False, ignore_reinit_error=True)
    except Exception as error:  # ConnectionError, RuntimeError, ValueError, of grpc ...
        text = " ".join(str(error).split())[:200]
        raise SetupError(
            f"no Ray cluster answers at {address}: {text}. Start one with `ray start --head`, or see docs/batch.md."
        ) from error
    return ray


def _require_answer(address: str) -> None:
    """Raise :class:`OSError` or :class:`ValueError` if nobody listens there; Ray itself would try for minutes."""
    if address == "auto":
        address = os.environ.get("RAY_ADDRESS", "")
    host, colon, port = address.removeprefix("ray://").rpartition(":")
    if colon:
        socket.create_connection((host, int(port)), timeout=ANSWER).close()


def absolute(task: Task) -> Task:
    """The task with paths that mean the same wherever a process was started; names of samples and URLs stay."""

    def path(place: str) -> str:
        kept = storage.is_url(place) or is_sample(place)
        return place if kept else os.path.abspath(storage.path_of(place))

    work = task.work.with_painted(lambda _, file: path(file))
    references = [text.rpartition("@") for text in work.references]
    work = replace(
        work,
        textured=path(work.textured) if work.textured else None,
        scene=path(work.scene) if work.scene else None,
        references=tuple(f"{path(picture)}@{turn}" for picture, _, turn in references),
    )
    asset = path(task.asset) if isinstance(task.asset, str) else task.asset
    return replace(task, asset=asset, work=work, folder=path(task.folder))


_supervisor: Supervisor | None = None
_idle: threading.Timer | None = None
_lock = threading.Lock()


def _attended(task: Task, limits: Limits, threads: int, command: Sequence[str] | None) -> BatchOutcome:
    """What a Ray worker does: one item, in the worker process that the last one left warm."""
    global _supervisor, _idle
    with _lock:
        if _idle is not None:
            _idle.cancel()
        key = (limits, threads, os.environ.get("CUDA_VISIBLE_DEVICES"), command)
        if _supervisor is None or getattr(_supervisor, "made_for", None) != key:
            _close()
            _supervisor = Supervisor(limits, Share(threads), **({"command": command} if command else {}))
            _supervisor.made_for = key  # pyright: ignore[reportAttributeAccessIssue]
        outcome = _supervisor.attend(task)
        _idle = threading.Timer(IDLE, _close_idle)
        _idle.daemon = True
        _idle.start()
        return outcome


def _close_idle() -> None:
    if _lock.acquire(blocking=False):  # else a task is under way
        try:
            _close()
        finally:
            _lock.release()


def _close() -> None:
    global _supervisor
    if _supervisor is not None:
        _supervisor.close()
    _supervisor = None
